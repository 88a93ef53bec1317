"""What is shown of a row of ``trees.csv`` wherever the tree appears: its status, its interval, its remark."""

from __future__ import annotations

from collections.abc import Mapping

from fsinfer.report.contents import number

#: The values of the column ``status``, in the order of trust, and the words for them.
STATUS_WORDS = {"ok": "measured", "doubtful": "doubtful", "unmeasured": "no diameter", "outside": "outside of the walk"}


def status_of(tree: Mapping[str, str]) -> str:
    """The status as a CSS class; a table without the column holds measured trees."""
    status = tree.get("status", "")
    return status if status in STATUS_WORDS else "ok"


def interval_of(tree: Mapping[str, str]) -> tuple[float, float] | None:
    """Ends of the 95 % interval of the DBH, cm; None where there is none."""
    low, high = number(tree.get("dbh_lo95_cm")), number(tree.get("dbh_hi95_cm"))
    return None if low is None or high is None else (low, high)


def interval_text(interval_cm: tuple[float, float]) -> str:
    """Both ends as text, without the unit."""
    return f"{interval_cm[0]:.1f} to {interval_cm[1]:.1f}"


def remark_of(tree: Mapping[str, str]) -> str:
    """The reasons for the status, and where it was measured if that is another part of the walk; may be empty."""
    part = tree.get("part") or ""
    texts = (f"measured in {part}, and put here by the pattern of the stems" if part else "", tree.get("reason") or "")
    return "; ".join(filter(None, texts))
