"""Digests of files: of the whole file, or of both ends where an edit shows there."""

from __future__ import annotations

import hashlib
from pathlib import Path

from fsinfer.errors import InputError
from fsinfer.io.photo_folders import VIDEO_SUFFIXES

#: Bytes read at either end of a compressed file for its digest: photographs and videos that differ do so in their
#: length, their headers or their last blocks. Source: numerics; a plot of 500 photographs is still checked in a second.
DIGEST_BYTES = 65536
# Kinds that are compressed, lower case: with what they show their length changes, or what stands at their end. Maps,
# clouds and tables keep their length when values in the middle are edited, so all others are read whole: 0.4 s for 300
# maps of 1 MB. Each look at 300 photographs of 5 MB would take 2.3 s whole; by their ends it takes 0.1 s.
_PHOTOS = (".jpg", ".jpeg", ".png", ".webp", ".heic", ".heif")
COMPRESSED_SUFFIXES = frozenset((*_PHOTOS, *VIDEO_SUFFIXES, ".laz"))
#: Bytes read at a time. Source: numerics.
_PIECE_BYTES = 1_048_576


def file_digest(path: Path) -> str:
    """Digest of a file's name, size and content, independent of its folder and its dates.

    Of files of ``COMPRESSED_SUFFIXES`` both ends stand for the content. Raises :class:`InputError` when the file cannot
    be read.
    """
    try:
        size = path.stat().st_size
        digest = hashlib.sha256(f"{path.name}\n{size}\n".encode())
        with path.open("rb") as stream:
            if path.suffix.lower() in COMPRESSED_SUFFIXES and size > 2 * DIGEST_BYTES:
                digest.update(stream.read(DIGEST_BYTES))
                stream.seek(size - DIGEST_BYTES)
            while content := stream.read(_PIECE_BYTES):
                digest.update(content)
    except OSError as error:
        msg = f"cannot read {path}: {error.strerror or error}"
        raise InputError(msg) from error
    return digest.hexdigest()[:24]
