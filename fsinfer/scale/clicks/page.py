"""The page on which the ends are clicked: one file, style and script inside, nothing from elsewhere."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from importlib import resources
from typing import TYPE_CHECKING

from fsinfer.scale.clicks.file import Draft
from fsinfer.scene import Scene, view_image_size

if TYPE_CHECKING:
    from markupsafe import Markup

#: Photographs that are open at first. Source: geometry; two rays meet.
_OPEN = 2
#: Of the source views of the first photograph this one is opened beside it, counted from the best: the best ones are
#: taken from nearly the same place. Source: layout; the user picks others.
_SOURCE = 3


@dataclass(frozen=True, kw_only=True)
class Photo:
    """A photograph as the page knows it: its name, its size in pixels, and its address below the page's."""

    name: str
    width: int
    height: int
    address: str


@dataclass(frozen=True, kw_only=True)
class ClickPage:
    """What the page is told.

    Attributes
    ----------
    photos: all of the scene.
    opened: which of them are shown at first.
    length_m: real distance of the two ends.
    draft: clicks of an earlier page.
    """

    photos: tuple[Photo, ...]
    opened: tuple[int, ...]
    length_m: float
    draft: Draft


def click_page(scene: Scene, length_m: float, draft: Draft) -> ClickPage:
    """The page of a scene; clicks in photographs that it does not have are left out."""
    photos = []
    for index, view in enumerate(scene.views):
        width, height = view_image_size(view)
        photos.append(Photo(name=view.name, width=width, height=height, address=f"photo/{index}"))
    number = {view.name: index for index, view in enumerate(scene.views)}
    known = {name: ends for name, ends in draft.items() if name in number}
    opened = [number[name] for name in sorted(known)]
    opened += [index for index in _first_pair(scene) if index not in opened][: max(_OPEN - len(opened), 0)]
    return ClickPage(photos=tuple(photos), opened=tuple(opened), length_m=length_m, draft=known)


def render_click_page(page: ClickPage, *, nonce: str) -> str:
    """The HTML; ``nonce`` lets its own style and script through the page's policy, and no others."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("fsinfer.scale.clicks"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    # ``tojson`` escapes "<", ">" and "&", so that no name of a photograph can end the script element.
    environment.globals["asset"] = _asset
    return environment.get_template("click.html.jinja").render(page=asdict(page), nonce=nonce)


def _first_pair(scene: Scene) -> list[int]:
    first = len(scene.views) // 2
    sources = scene.views[first].sources
    others = [sources[min(_SOURCE, len(sources) - 1)]] if sources else []
    return [first, *others, *(index for index in range(len(scene.views)) if index != first)]


def _asset(name: str) -> Markup:
    from markupsafe import Markup

    return Markup((resources.files("fsinfer.scale.clicks") / "assets" / name).read_text(encoding="utf-8"))
