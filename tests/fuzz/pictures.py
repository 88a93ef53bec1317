"""Readers of photographs, what they say of themselves, and videos."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from random import Random

import numpy as np

from tests.fuzz.lies import lie_in_png
from tests.fuzz.mutators import change_bytes, cut
from tests.fuzz.reader import Mutator, Reader

#: A photograph of the most pixels that are taken is unpacked, turned and copied: MiB.
_LARGEST_PHOTO_MB = 1700


def _picture() -> np.ndarray:
    return np.random.default_rng(0).integers(0, 255, (30, 44, 3), dtype=np.uint8)


def _make(folder: Path, *, names: tuple[str, ...]) -> None:
    from PIL import Image

    if any(name.endswith(".heic") for name in names):
        import pillow_heif

        pillow_heif.register_heif_opener()
    exif = Image.Exif()
    exif[0x010F], exif[0x0110], exif[0x0112] = "Maker", "Phone 1", 6
    exif.get_ifd(0x8769).update({0xA405: 26, 0x920A: 4.25})
    exif.get_ifd(0x8825).update({1: "N", 2: (48.0, 7.0, 12.5), 3: "E", 4: (11.0, 30.0, 1.0)})
    for name in names:
        Image.fromarray(_picture()).save(folder / name, exif=exif.tobytes())


def _read(folder: Path) -> None:
    from fsinfer.io.exif import camera_exif, camera_key, gnss_degrees
    from fsinfer.io.images import image_size, is_upright_jpeg_or_png, read_image

    # Each of them opens the file by itself, and none may rely on another having looked before.
    problems: list[Exception] = []
    for path in sorted(folder.iterdir()):
        for reader in (image_size, is_upright_jpeg_or_png, camera_key, camera_exif, gnss_degrees, read_image):
            try:
                reader(path)
            except _own_errors() as error:
                problems.append(error)
    if problems:
        raise problems[0]


def _own_errors() -> type[Exception]:
    from fsinfer.errors import FsinferError

    return FsinferError


def _in_exif(data: bytes, rng: Random) -> bytes:
    """Changes within the block that tells camera and place."""
    start = data.find(b"Exif\x00\x00")
    start = max(data.find(b"II*\x00"), data.find(b"MM\x00*")) if start < 0 else start + 6
    if start < 0:
        return change_bytes(data, rng)
    stop = min(start + 260, len(data))
    content = bytearray(data)
    for _ in range(rng.randint(1, 5)):
        at = rng.randrange(start, stop)
        content[at : at + 1] = bytes([rng.choice((0, 1, 2, 3, 5, 7, 10, 0xFF, rng.randrange(256)))])
    return bytes(content)


def _make_video(folder: Path) -> None:
    import cv2

    rng = np.random.default_rng(0)
    for name, code in (("walk.avi", "MJPG"), ("walk.mp4", "mp4v")):
        video = cv2.VideoWriter(str(folder / name), cv2.VideoWriter.fourcc(*code), 10.0, (64, 48))
        for _ in range(12):
            video.write(rng.integers(0, 255, (48, 64, 3), dtype=np.uint8))
        video.release()


def _read_video(folder: Path) -> None:
    from fsinfer.frames.settings import VideoSettings
    from fsinfer.frames.video import sharpest_frames
    from fsinfer.progress import silent

    for path in sorted(folder.iterdir()):
        for _ in sharpest_frames(path, settings=VideoSettings(interval_s=0.3), progress=silent):
            pass


def _photo(name: str, what: str, files: tuple[str, ...], *extra: Mutator) -> Reader:
    return Reader(
        name=name, what=what, make=partial(_make, names=files), targets=("*",), read=_read,
        mutators=(*extra, change_bytes, cut), most_mb=_LARGEST_PHOTO_MB,
    )  # fmt: skip


READERS = (
    _photo("jpeg", "JPEG photographs", ("a.jpg",), _in_exif),
    _photo("png", "PNG photographs", ("a.png",), lie_in_png),
    _photo("tiff", "TIFF, WebP and BMP photographs", ("a.tif", "b.webp", "c.bmp"), _in_exif),
    _photo("heic", "HEIC photographs", ("a.heic",), _in_exif),
    Reader(name="video", what="videos (AVI, MP4)", make=_make_video, targets=("*",), read=_read_video,
           mutators=(change_bytes, cut), most_mb=1024),
)  # fmt: skip
