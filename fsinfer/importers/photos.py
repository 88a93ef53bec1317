"""From the names in a file to the photographs on the disk."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from fsinfer.errors import SceneError
from fsinfer.importers.files import find_photo, view_names
from fsinfer.importers.foreign import Floats, ForeignPhoto
from fsinfer.importers.lens import Lens
from fsinfer.notices.numbers import counted

#: Photographs that depth can be computed of at least. Source: format; two from different places.
LEAST_PHOTOS = 2
#: Names of photographs that a message tells. Source: layout.
_NAMES_TOLD = 3


@dataclass(frozen=True, kw_only=True)
class Registered:
    """A photograph with its pose as a file tells it; ``number`` is what the file calls it besides."""

    name: str
    lens: Lens
    cam_from_world: Floats
    number: int = 0


@dataclass(frozen=True, kw_only=True)
class Gathered:
    """Photographs that were found; ``numbers`` by the names of their views.

    ``missing`` are the names of those that were not found, or of which nobody can tell which they are; ``alike`` the
    names among these that several photographs have.
    """

    photos: tuple[ForeignPhoto, ...]
    numbers: Mapping[str, int]
    missing: tuple[str, ...]
    alike: tuple[str, ...] = ()

    @property
    def remarks(self) -> tuple[str, ...]:
        """What a user has to know of it."""
        if not self.alike:
            return ()
        told = ", ".join(self.alike[:_NAMES_TOLD]) + (", ..." if len(self.alike) > _NAMES_TOLD else "")
        return (
            f"photographs that share a file are left out ({told}), because nobody can tell which of them it is; give "
            "them different names and export the cameras again",
        )


def gather(registered: Sequence[Registered], folders: Sequence[Path], *, source: Path) -> Gathered:
    """Look the photographs up in ``folders``.

    Raises
    ------
    SceneError
        Fewer than two have a pose, or fewer than two of them are there; ``source`` is the file that names them.
    """
    if len(registered) < LEAST_PHOTOS:
        many = counted(len(registered), "photograph", "photographs")
        msg = f"{source} holds {many} with a pose; depth needs two from different places at least"
        raise SceneError(msg)
    photos, numbers, missing = [], {}, []
    paths = [find_photo(item.name, folders) for item in registered]
    times = Counter(path.resolve() for path in paths if path is not None)
    alike = []
    for name, item, path in zip(view_names([item.name for item in registered]), registered, paths, strict=True):
        if path is None:
            missing.append(item.name)
            continue
        if times[path.resolve()] > 1:
            missing.append(item.name)
            alike.append(item.name)
            continue
        photos.append(ForeignPhoto(name=name, path=path, lens=item.lens, cam_from_world=item.cam_from_world))
        numbers[name] = item.number
    if len(photos) < LEAST_PHOTOS:
        told = ", ".join(missing[:_NAMES_TOLD])
        looked = " or ".join(str(folder) for folder in dict.fromkeys(folders))
        msg = (
            f"of the {len(registered)} photographs in {source} {len(missing)} are not in {looked} ({told}, ...); "
            "give their folder with --images"
        )
        if alike:
            told = ", ".join(alike[:_NAMES_TOLD])
            msg = (
                f"of the {len(registered)} photographs in {source} {len(alike)} share a file with another ({told}), "
                "and nobody can tell which of them it is; give them different names and export the cameras again"
            )
        raise SceneError(msg)
    return Gathered(photos=tuple(photos), numbers=numbers, missing=tuple(missing), alike=tuple(dict.fromkeys(alike)))
