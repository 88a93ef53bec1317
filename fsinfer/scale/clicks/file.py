"""``scale_clicks.json`` in an output folder: the clicks that give its scale, and those of a page that was left open."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fsinfer.errors import InputError
from fsinfer.io.files import write_text
from fsinfer.io.json_text import read_json
from fsinfer.scale.request import ClickedEnds, ClickedLength, Pixel, Size

CLICKS_FILE = "scale_clicks.json"
#: Clicks of a page: by the name of the view the pixels of both ends, None where one was not clicked yet.
Draft = Mapping[str, tuple[Pixel | None, Pixel | None]]


@dataclass(frozen=True, kw_only=True)
class SavedClicks:
    """What the file holds: ``used`` gives the scale of the folder, ``draft`` is what the page showed last.

    ``sizes`` are those of the pictures that the draft was clicked in; files of earlier versions hold none.
    """

    used: ClickedLength | None = None
    draft: Draft = field(default_factory=dict)
    sizes: Mapping[str, Size] = field(default_factory=dict)


def read_clicks(out: Path) -> SavedClicks:
    """Read the file of an output folder; nothing where there is none. :class:`InputError` where it is damaged."""
    path = out / CLICKS_FILE
    try:
        content = read_json(path)
    except (FileNotFoundError, NotADirectoryError):
        # Where a file was given as the folder, whoever makes the folder says so.
        return SavedClicks()
    except (OSError, ValueError) as error:
        msg = f"{path} cannot be read ({error}); delete it, and click the ends again with fsinfer scale"
        raise InputError(msg) from error
    try:
        used, length = content["used"], None
        if used is not None:
            length = clicked_length(used["clicks"], used["length_m"], _read_sizes(used.get("sizes", {})))
        return SavedClicks(used=length, draft=read_draft(content["draft"]), sizes=_read_sizes(content.get("sizes", {})))
    except (KeyError, TypeError, AttributeError, InputError) as error:
        msg = f"{path} holds no clicks ({error}); delete it, and click the ends again with fsinfer scale"
        raise InputError(msg) from error


def write_clicks(out: Path, saved: SavedClicks) -> Path:
    """Write the file, atomically."""
    used = saved.used
    content = {
        "used": None
        if used is None
        else {
            "length_m": used.length_m,
            "clicks": {ends.view: [ends.first, ends.second] for ends in used.views},
            "sizes": {ends.view: ends.size for ends in used.views if ends.size is not None},
        },
        "draft": saved.draft,
        "sizes": {name: saved.sizes[name] for name in saved.draft if name in saved.sizes},
    }
    path = out / CLICKS_FILE
    write_text(path, json.dumps(content, indent=1) + "\n")
    return path


def clicked_length(clicks: object, length_m: float, sizes: Mapping[str, Size]) -> ClickedLength:
    """The views in which both ends were clicked; :class:`InputError` for what holds no clicks.

    ``sizes``: of the pictures that were clicked in, by the view's name.
    """
    views = tuple(
        ClickedEnds(view=name, first=first, second=second, size=sizes.get(name))
        for name, (first, second) in sorted(read_draft(clicks).items())
        if first is not None and second is not None
    )
    return ClickedLength(views=views, length_m=length_m)


def read_draft(clicks: object) -> dict[str, tuple[Pixel | None, Pixel | None]]:
    """``{view: [[u, v] or null, [u, v] or null]}`` as it comes from the page; :class:`InputError` for anything else."""
    if not isinstance(clicks, Mapping):
        msg = "the clicks are no object"
        raise InputError(msg)
    return {str(name): _two_ends(name, ends) for name, ends in clicks.items()}


def _read_sizes(sizes: object) -> dict[str, Size]:
    if not isinstance(sizes, Mapping):
        msg = "the sizes are no object"
        raise InputError(msg)
    return {str(name): _size(name, size) for name, size in sizes.items()}


def _size(name: object, size: object) -> Size:
    numbers = size if isinstance(size, (list, tuple)) else ()
    sound = [n for n in numbers if isinstance(n, int) and not isinstance(n, bool) and n > 0]
    if len(sound) != 2 or len(numbers) != 2:
        msg = f"{name}: {size!r} is no size of a picture"
        raise InputError(msg)
    return sound[0], sound[1]


def _two_ends(name: object, ends: Any) -> tuple[Pixel | None, Pixel | None]:
    if not isinstance(ends, (list, tuple)) or len(ends) != 2:
        msg = f"{name}: a photograph has two ends"
        raise InputError(msg)
    return _pixel(name, ends[0]), _pixel(name, ends[1])


def _pixel(name: object, place: Any) -> Pixel | None:
    if place is None:
        return None
    numbers = place if isinstance(place, (list, tuple)) else ()
    sound = [n for n in numbers if isinstance(n, (int, float)) and not isinstance(n, bool) and math.isfinite(n)]
    if len(sound) != 2 or len(numbers) != 2:
        msg = f"{name}: {place!r} is no pixel"
        raise InputError(msg)
    return float(sound[0]), float(sound[1])
