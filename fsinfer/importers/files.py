"""Reading files of other programs: bounded by what they really hold, with one message for what does not fit."""

from __future__ import annotations

import itertools
import re
import struct
import unicodedata
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path, PurePosixPath
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import SceneError
from fsinfer.io.json_text import parse_json
from fsinfer.io.photo_folders import PHOTO_SUFFIXES

#: Text larger than this is no list of cameras. Source: numerics; points3D.txt of 1,000 photos has 500 MB.
_MOST_TEXT_BYTES = 2_000_000_000
#: Numbers beyond are none of a camera or a place. Source: numerics; their squares and products stay finite.
MOST = 1e12
#: What file systems do not allow in a name. Source: format; Windows, and the control characters.
_NOT_IN_NAMES = re.compile(r'[\x00-\x1f<>:"/\\|?*]')
#: Of letters with accents: in one character, and in two. Source: format; Unicode Standard Annex 15.
_FORMS: Final = ("NFC", "NFD")
#: Letters of a view's name at most. Source: format; 255 bytes of a file name, less what is added to it.
_LONGEST_NAME = 120


def read_bytes(path: Path) -> bytes:
    """The whole file; :class:`SceneError` where it cannot be read or is larger than any such file."""
    try:
        size = path.stat().st_size
        if size > _MOST_TEXT_BYTES:
            msg = (
                f"{path} has {size / 1e9:.1f} GB, too much for cameras and tie points; export them without dense points"
            )
            raise SceneError(msg)
        return path.read_bytes()
    except OSError as error:
        msg = f"cannot read {path}: {error.strerror or error}; check the path"
        raise SceneError(msg) from error


def read_text(path: Path) -> str:
    """The file as UTF-8, with or without a byte order mark."""
    try:
        return read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise unfit(path, f"no text in UTF-8, byte {error.start}") from error


def read_json(path: Path) -> dict[str, Any]:
    """The object in a JSON file."""
    try:
        value = parse_json(read_text(path))
    except ValueError as error:
        raise unfit(path, f"no JSON: {error}") from error
    if not isinstance(value, dict):
        raise unfit(path, "no JSON object")
    return value


def unfit(path: Path, why: str) -> SceneError:
    """The error for a file that is not what its name says."""
    return SceneError(f"{path} cannot be read as a scene ({why}); export it again")


def numbers(values: Any, count: int, path: Path, what: str) -> NDArray[np.float64]:
    """``count`` finite numbers from text, or from lists of numbers in lists.

    Raises
    ------
    SceneError
        There are others, or more, or fewer.
    """
    try:
        if isinstance(values, str):
            values = values.split()
        array = np.array(values, dtype=np.float64).ravel()
    except (TypeError, ValueError, OverflowError) as error:
        raise unfit(path, f"{what} are no numbers") from error
    if len(array) != count or not (np.abs(array) < MOST).all():
        raise unfit(path, f"{what}: {count} finite numbers are needed, {len(array)} are there")
    return array


class ByteReader:
    """Reads little-endian numbers from the start of a file on, never more than it holds."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._data = read_bytes(path)
        self._at = 0

    @property
    def left(self) -> int:
        """Bytes not yet read."""
        return len(self._data) - self._at

    def take(self, form: str) -> tuple[Any, ...]:
        """Numbers by a format of :mod:`struct`, without the sign for the byte order."""
        layout = struct.Struct(f"<{form}")
        self._need(layout.size)
        values = layout.unpack_from(self._data, self._at)
        self._at += layout.size
        return values

    def count(self, form: str, least_bytes: int) -> int:
        """A count of things that take ``least_bytes`` each at least, which the rest of the file has to hold."""
        (count,) = self.take(form)
        if count < 0 or count * least_bytes > self.left:
            raise unfit(self.path, f"it promises {count} entries and ends before")
        return int(count)

    def array(self, dtype: str, count: int) -> NDArray[Any]:
        """``count`` values of one type."""
        size = np.dtype(dtype).itemsize * count
        self._need(size)
        values = np.frombuffer(self._data, dtype=dtype, count=count, offset=self._at)
        self._at += size
        return values

    def skip(self, size: int) -> None:
        """Leave out ``size`` bytes."""
        self._need(size)
        self._at += size

    def text_to_nul(self) -> str:
        """Text up to the next NUL, which is left out."""
        end = self._data.find(b"\0", self._at)
        if end < 0:
            raise unfit(self.path, "a name has no end")
        raw, self._at = self._data[self._at : end], end + 1
        return raw.decode("utf-8", errors="replace")

    def text(self, size: int) -> str:
        """Text of ``size`` bytes."""
        self._need(size)
        raw = self._data[self._at : self._at + size]
        self._at += size
        return raw.decode("utf-8", errors="replace")

    def _need(self, size: int) -> None:
        if size > self.left:
            raise unfit(self.path, "it is cut short")


def view_names(names: Sequence[str]) -> list[str]:
    """A name for each view from the names of photographs in a file: no folders, no two alike, fit for any disk."""
    parts = [_parts(name) for name in names]
    stems = [_stem(part) for part in parts]
    times = Counter(stems)
    # Photos of two cards have the same numbers: their folders tell them apart.
    plain = ["_".join((*part[:-1], stem)) if times[stem] > 1 else stem for part, stem in zip(parts, stems, strict=True)]
    found: list[str] = []
    used: set[str] = set()
    for name in plain:
        clean = _NOT_IN_NAMES.sub("_", name).strip(" .")[-_LONGEST_NAME:] or "photo"
        unique, number = clean, 2
        # File systems of phones and laptops do not tell A from a.
        while unique.lower() in used:
            unique, number = f"{clean}_{number}", number + 1
        used.add(unique.lower())
        found.append(unique)
    return found


def find_photo(name: str, folders: Iterable[Path]) -> Path | None:
    """The file of a photograph that another program calls ``name``, in one of ``folders``; None where it is in none.

    Of its path the end counts that is there: the photographs may have been moved, and nothing outside of the folders
    is looked at. Without a suffix each one of a photograph is tried.

    Raises
    ------
    SceneError
        It has no suffix, and several files of one folder fit it.
    """
    parts = _parts(name)
    if not parts:
        return None
    named = Path(parts[-1]).suffix.lower() in PHOTO_SUFFIXES
    # Names from a Mac may have their umlauts in two characters, and other file systems do not tell them as one.
    forms = {parts: None} | {tuple(unicodedata.normalize(form, part) for part in parts): None for form in _FORMS}
    for folder, start, form in itertools.product(folders, range(len(parts)), forms):
        files = [form[-1]] if named else [f"{form[-1]}{suffix}" for suffix in _suffixes()]
        found = _files(folder.joinpath(*form[start:-1]), files)
        if len(found) > 1:
            msg = (
                f"the photograph {name} may be {' or '.join(path.name for path in found)} in {found[0].parent}; "
                "leave the one there that its cameras were computed from"
            )
            raise SceneError(msg)
        if found:
            return found[0]
    return None


def _files(folder: Path, names: Iterable[str]) -> list[Path]:
    """Those of the files that are in the folder, one path for each."""
    found: list[Path] = []
    for name in names:
        path = folder / name
        try:
            # Many file systems do not tell .jpg from .JPG.
            if path.is_file() and not any(path.samefile(other) for other in found):
                found.append(path)
        except (OSError, ValueError):
            continue  # no name on this file system
    return found


def _suffixes() -> list[str]:
    return [form for suffix in sorted(PHOTO_SUFFIXES) for form in (suffix, suffix.upper())]


def _parts(name: str) -> tuple[str, ...]:
    """The parts of a path of any system, without drive, root and steps upwards."""
    whole = PurePosixPath(name.replace("\\", "/").replace("\0", ""))
    return tuple(part for part in whole.parts if part not in ("/", "//", "..", ".") and not part.endswith(":"))


def _stem(parts: tuple[str, ...]) -> str:
    last = parts[-1] if parts else "photo"
    path = Path(last)
    return path.stem if path.suffix.lower() in PHOTO_SUFFIXES else last
