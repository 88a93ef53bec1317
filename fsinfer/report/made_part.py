"""How the results were made: model, time, memory, versions and settings."""

from __future__ import annotations

import json
from dataclasses import dataclass

from fsinfer.report.contents import Contents, number
from fsinfer.report.page import Part, missing_part

_ANCHOR, _TITLE = "made", "How it was made"


@dataclass(frozen=True, kw_only=True)
class MadeView:
    """Names and values; ``settings`` of all stages as text, empty where they are not known."""

    facts: tuple[tuple[str, str], ...]
    settings: str


def made_part(contents: Contents) -> Part:
    """All that is needed to make the same results again."""
    plot = contents.plot
    if not plot:
        return missing_part(_ANCHOR, _TITLE, f"{contents.why_missing('plot.json')}.")
    rows = [("Depth model", str(plot.get("model") or "not known"))]
    rows.append(("SHA-256 of the model", str(plot.get("model_sha256") or "not known")))
    if plot.get("model_precision"):
        rows.append(("Numbers of the depth network", str(plot["model_precision"])))
    peak = number(plot.get("peak_rss_mb"))
    if peak is not None:
        rows.append(("Largest memory", f"{peak:,.0f} MB"))
    seconds = plot.get("seconds")
    if isinstance(seconds, dict):
        rows += [
            ("Total time" if name == "total" else f"Time for {name}", _duration(value))
            for name, text in seconds.items()
            if (value := number(text)) is not None
        ]
    versions = plot.get("versions")
    if isinstance(versions, dict):
        rows.append(("Versions", ", ".join(f"{name} {text}" for name, text in versions.items() if text)))
    settings = json.dumps(plot["settings"], indent=1, ensure_ascii=False) if plot.get("settings") else ""
    return Part(anchor=_ANCHOR, title=_TITLE, view=MadeView(facts=tuple(rows), settings=settings))


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.1f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min"
