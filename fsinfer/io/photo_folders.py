"""Which files of a folder are photographs, and which only look like it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable
from contextlib import suppress
from pathlib import Path

from fsinfer.errors import ImageError
from fsinfer.io.names import by_number

#: What :func:`list_images` takes for a photograph, lower case.
PHOTO_SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp", ".webp", ".heic", ".heif"})
#: Pictures that nothing here reads: raw ones of cameras and phones, and rare kinds.
_UNREAD_SUFFIXES = frozenset(
    {".dng", ".arw", ".cr2", ".cr3", ".nef", ".orf", ".raf", ".rw2", ".avif", ".jxl", ".jp2", ".gif"}
)
#: What is taken for a video, lower case. Source: format.
VIDEO_SUFFIXES = frozenset(
    {".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm", ".3gp", ".3g2", ".mts", ".m2ts", ".mpg", ".mpeg", ".wmv"}
)
#: Videos that nothing here reads: both eyes of a camera of the whole sphere. Source: format; Insta360, GoPro MAX.
_UNREAD_VIDEO_SUFFIXES = frozenset({".insv", ".360"})
#: Files by which a folder of results is known, whose pictures are no photographs. Source: format.
_RESULTS = frozenset({"plot.json", "frames.csv", "report.html"})


def list_images(folder: Path | str, *, videos: Collection[str] = ()) -> list[Path]:
    """Return the photographs directly in ``folder``, sorted by name, 2 before 10; hidden files are not taken.

    Parameters
    ----------
    videos: suffixes, lower case, of what the caller takes besides, and the message speaks of too.

    Raises
    ------
    ImageError
        ``folder`` is missing or holds no photograph.
    """
    folder = Path(folder)
    if not folder.is_dir():
        what = "is a file" if folder.exists() else "does not exist"
        msg = f"{folder} {what}; give a folder of photos"
        raise ImageError(msg)
    found = (
        path
        for path in folder.iterdir()
        if path.suffix.lower() in PHOTO_SUFFIXES and not path.name.startswith(".") and path.is_file()
    )
    paths = sorted(found, key=lambda path: by_number(path.name))
    if not paths:
        way_out = "give the folder that your photos lie in"
        if within := folders_of_photos(folder, PHOTO_SUFFIXES | set(videos)):
            way_out = (
                f"give one of those within it that do ({', '.join(within)}), or put all photos of the plot into one"
            )
            if len(within) > 1:
                way_out += "; where each of them is a plot, fsinfer batch measures them all by a table"
        elif unread := unread_photos(folder):
            way_out = f"export its {', '.join(unread)} files as JPEG"
        elif spheres := unread_videos(folder):
            way_out = f"its {', '.join(spheres)} files are of a camera of the whole sphere: take flat photos or videos"
        what = "photos or videos" if videos else "photos"
        msg = f"{folder} holds no {what} ({', '.join(sorted(PHOTO_SUFFIXES | set(videos)))}); {way_out}"
        raise ImageError(msg)
    return paths


def unread_photos(folder: Path) -> dict[str, int]:
    """How many pictures directly in ``folder`` are of which kind that is not read.

    Those that lie there as another kind, too, do not count: phones write a raw file beside the JPEG.
    """
    paths = _shown_files(folder)
    read = {_shot(path) for path in paths if path.suffix.lower() in PHOTO_SUFFIXES}
    return _count_kinds((path for path in paths if _shot(path) not in read), _UNREAD_SUFFIXES)


def unread_videos(folder: Path) -> dict[str, int]:
    """How many videos directly in ``folder`` are of which kind that is not read."""
    return _count_kinds(_shown_files(folder), _UNREAD_VIDEO_SUFFIXES)


def _shown_files(folder: Path) -> list[Path]:
    return [path for path in folder.iterdir() if not path.name.startswith(".") and path.is_file()]


def _count_kinds(paths: Iterable[Path], kinds: Collection[str]) -> dict[str, int]:
    """How many of the files are of which of the kinds, suffixes in lower case."""
    return dict(sorted(Counter(kind for path in paths if (kind := path.suffix.lower()) in kinds).items()))


def _shot(path: Path) -> str:
    """What the files of one shot have in common: PXL_1.RAW-01.COVER.jpg and PXL_1.RAW-02.ORIGINAL.dng."""
    return path.stem.lower().split(".raw-")[0]


def folders_of_photos(folder: Path, suffixes: Collection[str] = PHOTO_SUFFIXES) -> dict[str, int]:
    """How many photographs lie in which folders within ``folder``, by name; hidden ones and results do not count."""
    found = {}
    for inner in sorted(path for path in folder.iterdir() if path.is_dir() and not path.name.startswith(".")):
        with suppress(OSError):  # what may not be looked into tells nothing
            paths = [path for path in inner.iterdir() if not path.name.startswith(".")]
            count = sum(path.suffix.lower() in suffixes for path in paths)
            if count and not _RESULTS.intersection(path.name for path in paths):
                found[inner.name] = count
    return found
