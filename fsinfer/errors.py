"""The exception tree: everything that goes wrong by the user's input is a :class:`FsinferError`.

Each message says *what* is wrong, *where* (file, folder, row) and *what to do* about it. The command line
prints it on one line and exits with code 2; anything that is not a ``FsinferError`` is a fault of ours
(exit code 1).
"""

from __future__ import annotations

#: What the command line says when memory ran out, by which a batch knows that another attempt is worth it.
NOT_ENOUGH_MEMORY = "this computer has not enough free memory"
#: And where COLMAP crashed: what crashes once may go well the next time.
CRASHED = "finding poses crashed"
#: Length of a message that is still read in a terminal. Source: judgement.
_MOST_LETTERS = 1500


class FsinferError(Exception):
    """Base class of every error that a user can put right.

    A message that quotes half of a damaged file says nothing: the middle of a long one is left out.
    """

    def __init__(self, message: str = "") -> None:
        if len(message) > _MOST_LETTERS:
            message = f"{message[: _MOST_LETTERS * 2 // 3]} [...] {message[-_MOST_LETTERS // 3 :]}"
        super().__init__(message)


class InputError(FsinferError):
    """A file, a folder or an option given by the user cannot be used."""


class ImageError(InputError):
    """A photograph or a video cannot be read or does not fit the others."""


class PosesError(FsinferError):
    """Structure from motion found no usable camera poses."""


class SceneError(InputError):
    """A scene folder in MVSNet format is incomplete or inconsistent."""


class ModelError(FsinferError):
    """A depth model is missing, damaged, or does not match its manifest."""


class CloudError(InputError):
    """A point cloud cannot be read, or holds nothing that can be used."""


class ScaleError(FsinferError):
    """No trustworthy metric scale could be found."""


class OutputError(FsinferError):
    """A result cannot be written (folder not writable, disk full)."""


class WorkerLostError(FsinferError):
    """The worker of a cluster that had a piece of work is gone; another may do it."""


class ClusterError(FsinferError):
    """A cluster cannot be used at all, or not any more."""
