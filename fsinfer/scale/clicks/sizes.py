"""Clicks in pictures that have another size by now: what was clicked is a place in a picture, kept in its pixels.

Photographs are reduced by how large the user lets them be, so that a run with another limit makes pictures that show
the same at another size.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace

from fsinfer.errors import ImageError, ScaleError
from fsinfer.scale.clicks.file import SavedClicks
from fsinfer.scale.request import ClickedEnds, ClickedLength, Pixel, Size
from fsinfer.scene import Scene, view_image_size

#: A picture whose width and height changed by shares that differ by more does not show the same. Source: geometry;
#: whole pixels round those of a picture of a hundred pixels by half of that.
SAME_SHAPE = 0.01


def picture_sizes(scene: Scene) -> dict[str, Size]:
    """(width, height) of the pictures of a scene, from their headers alone; without those that cannot be read."""
    sizes = {}
    for view in scene.views:
        # Clicks need no pixels: a photograph that was deleted since keeps nobody from measuring a cloud.
        with suppress(OSError, ImageError):
            sizes[view.name] = view_image_size(view)
    return sizes


def has_sizes(saved: SavedClicks) -> bool:
    """Whether all clicks are known to be of pictures of some size; true where there are none."""
    used = saved.used is None or all(ends.size is not None for ends in saved.used.views)
    return used and saved.draft.keys() <= saved.sizes.keys()


def with_sizes(saved: SavedClicks, sizes: Mapping[str, Size]) -> SavedClicks:
    """Clicks of an earlier version, which kept no sizes, as clicked in pictures of ``sizes``; others as they are."""
    used = saved.used
    if used is not None:
        used = replace(used, views=tuple(replace(e, size=e.size or sizes.get(e.view)) for e in used.views))
    missing = {name: sizes[name] for name in saved.draft if name in sizes and name not in saved.sizes}
    return replace(saved, used=used, sizes={**saved.sizes, **missing})


def fit_clicks(clicked: ClickedLength, sizes: Mapping[str, Size]) -> ClickedLength:
    """The same places in pictures of these sizes; views that are not among them are left as they are.

    Raises
    ------
    ScaleError
        A picture has another shape than the one that was clicked in: it does not show the same.
    """
    return replace(clicked, views=tuple(_fit_ends(ends, sizes.get(ends.view)) for ends in clicked.views))


def fit_draft(saved: SavedClicks, sizes: Mapping[str, Size]) -> SavedClicks:
    """The draft for a page that shows pictures of these sizes, without the clicks in pictures of another shape."""
    draft, now_sizes = {}, {}
    for name, (first, second) in saved.draft.items():
        was, now = saved.sizes.get(name), sizes.get(name)
        if was is None or now is None:
            draft[name] = first, second
        elif _same_shape(was, now):
            draft[name] = first and _moved(first, was, now), second and _moved(second, was, now)
        if now is not None:
            now_sizes[name] = now
    return replace(saved, draft=draft, sizes=now_sizes)


def _fit_ends(ends: ClickedEnds, now: Size | None) -> ClickedEnds:
    was = ends.size
    if was is None or now is None or was == now:
        return ends
    if not _same_shape(was, now):
        msg = f"the picture {ends.view} had {was[0]}x{was[1]} pixels and has {now[0]}x{now[1]}"
        raise ScaleError(msg)
    first, second = (_moved(end, was, now) for end in (ends.first, ends.second))
    return replace(ends, first=first, second=second, size=now)


def _same_shape(was: Size, now: Size) -> bool:
    return abs(now[0] * was[1] / (now[1] * was[0]) - 1) <= SAME_SHAPE


def _moved(end: Pixel, was: Size, now: Size) -> Pixel:
    """The same place in a picture of another size; the corner of the top left pixel is (-0.5, -0.5) in both."""
    return (end[0] + 0.5) * now[0] / was[0] - 0.5, (end[1] + 0.5) * now[1] / was[1] - 0.5
