"""Rendering: the only place that makes HTML, from the templates beside this module; every text is escaped there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jinja2 import Environment
    from markupsafe import Markup

# The package whose templates these are.
_OWN = "fsinfer.report"


@dataclass(frozen=True, kw_only=True)
class Part:
    """A part of the page before it is rendered.

    Attributes
    ----------
    anchor: id of its section.
    title: its heading, and its link at the top of the page; a part without one is neither section nor link.
    view: what its template shows, a frozen dataclass. Its texts are plain text.
    template: ``templates/NAME.html.jinja``; named as the anchor unless it is given.
    """

    anchor: str
    title: str = ""
    view: object
    template: str = ""


@dataclass(frozen=True, kw_only=True)
class MissingView:
    """Why there is nothing to show."""

    why: str


@dataclass(frozen=True, kw_only=True)
class RenderedPart:
    """A part of the page as HTML."""

    anchor: str
    title: str
    html: Markup


def missing_part(anchor: str, title: str, why: str) -> Part:
    """A section that only says why there is nothing to show."""
    return Part(anchor=anchor, title=title, view=MissingView(why=why), template="missing")


def render_part(part: Part, *, templates: str = _OWN) -> RenderedPart:
    """Fill the template of one part; ``templates`` is the package that has it, where it is none of this one."""
    from markupsafe import Markup

    template = _environment(templates).get_template(f"{part.template or part.anchor}.html.jinja")
    return RenderedPart(anchor=part.anchor, title=part.title, html=Markup(template.render(view=part.view)))


def render_page(title: str, subtitle: str, parts: Sequence[RenderedPart]) -> str:
    """Return the whole page; ``title`` and ``subtitle`` are plain text."""
    return _environment().get_template("page.html.jinja").render(title=title, subtitle=subtitle, parts=parts)


@cache
def _environment(templates: str = _OWN) -> Environment:
    # Here, not at the top: only who makes a report pays for it.
    from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=ChoiceLoader([PackageLoader(package) for package in dict.fromkeys((templates, _OWN))]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    # ``tojson`` escapes "<", ">" and "&", so that no text in it can end its script element; it takes dataclasses too.
    environment.policies["json.dumps_kwargs"] = {"default": asdict}
    environment.globals["asset"] = _asset
    environment.filters["px"] = lambda length_px: f"{length_px:.1f}"
    return environment


def _asset(name: str) -> Markup:
    """A style sheet or script of ours, which goes into the page as it is."""
    from markupsafe import Markup

    return Markup((resources.files("fsinfer.report") / "assets" / name).read_text(encoding="utf-8"))
