"""The clicks that an output folder keeps, with the sizes of the pictures that they were made in."""

from __future__ import annotations

from pathlib import Path

from fsinfer.errors import FsinferError
from fsinfer.scale.clicks.file import SavedClicks, read_clicks, write_clicks
from fsinfer.scale.clicks.sizes import has_sizes, picture_sizes, with_sizes
from fsinfer.scene import read_scene


def kept_clicks(out: Path) -> SavedClicks:
    """Read them; where an earlier version kept no sizes, they become those of the scene that lies in the folder.

    To be called before another scene takes its place. :class:`InputError` where the file is damaged.
    """
    saved = read_clicks(out)
    if has_sizes(saved):
        return saved
    try:
        scene = read_scene(out / "scene")
    except FsinferError:
        return saved
    known = with_sizes(saved, picture_sizes(scene))
    if known != saved:
        write_clicks(out, known)
    return known
