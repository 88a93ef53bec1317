"""Calls of COLMAP whose failures are told apart from faults of ours.

pycolmap turns what C++ throws into ``RuntimeError``, ``ValueError`` or ``IndexError``, which our own code raises too
when it is wrong. A failure of COLMAP is one that comes out of a call of COLMAP and was not raised in Python on the way.
"""

from __future__ import annotations

import signal
import sqlite3
import threading
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from fsinfer.errors import PosesError

#: COLMAP draws random samples; a fixed seed, and one thread where sums are taken, make two runs on one machine alike.
#: Source: numerics.
SEED = 1
#: What to do where pycolmap is missing.
MISSING = (
    "finding poses needs pycolmap, which cannot be loaded here ({error}); pip has it for Linux on x86-64, Windows on "
    "x64 and Macs with Apple silicon, elsewhere use conda: conda install -c conda-forge 'pycolmap>=4.2.1'. Or register "
    "the photos in another program: fsinfer depth reads scenes of COLMAP, Metashape and others"
)


class ColmapError(Exception):
    """COLMAP itself failed; caught by :func:`fsinfer.poses.colmap.colmap_errors`."""


def require_pycolmap() -> None:
    """Raise :class:`PosesError` with the way out where pycolmap is not installed or cannot be loaded."""
    try:
        import pycolmap  # noqa: F401
    except ImportError as error:
        raise PosesError(MISSING.format(error=error)) from error
    handler = signal.getsignal(signal.SIGTERM)
    if threading.current_thread() is threading.main_thread() and handler is not None:
        # Once loaded, its library prints a trace where a program is told to end; who asked for the end needs none.
        signal.signal(signal.SIGTERM, handler)


def call(function: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
    """Call a function of pycolmap.

    Raises
    ------
    ColmapError
        COLMAP failed. What a callback of ours raises on the way, and arguments that do not fit, pass as they are.
    """
    try:
        return function(*arguments, **options)
    except (RuntimeError, ValueError, IndexError) as error:
        trace = error.__traceback__
        if trace is not None and trace.tb_next is not None:
            raise  # from a Python function that COLMAP called
        raise ColmapError(" ".join(str(error).split())) from error


class _Guarded:
    """An object of pycolmap whose methods are called by :func:`call`."""

    def __init__(self, target: Any) -> None:
        self._target = target

    @property
    def itself(self) -> Any:
        """The object, for functions of pycolmap that take it."""
        return self._target

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._target, name)
        return (lambda *arguments, **options: call(value, *arguments, **options)) if callable(value) else value


@contextmanager
def open_database(path: Path) -> Iterator[Any]:
    """A ``pycolmap.Database`` whose methods raise :class:`ColmapError` where COLMAP fails; a missing file is made."""
    import pycolmap

    database = call(pycolmap.Database.open, path)
    with database:
        yield _Guarded(database)


def database_cache(database: Path, *, all_photos: bool = False) -> Any:
    """The ``pycolmap.DatabaseCache`` of a database; ``all_photos``: of those without a match as well."""
    import pycolmap

    options = pycolmap.DatabaseCacheOptions()
    options.load_all_images = all_photos
    with call(pycolmap.Database.open, database) as opened:
        return call(pycolmap.DatabaseCache.create, opened, options)


def image_number(opened: Any, name: str) -> int:
    """The number of a photo, by its name, in a database of :func:`open_database`."""
    return int(opened.read_image_with_name(name).image_id)


def copy_database(database: Path, copy: Path) -> None:
    """Copy a database with what is still in its log; a file ``copy`` of before goes."""
    copy.unlink(missing_ok=True)
    with closing(sqlite3.connect(database)) as source, closing(sqlite3.connect(copy)) as target:
        source.backup(target)


def copy_for_mapping(database: Path, copy: Path) -> None:
    """Copy a database without its descriptors, which nothing but matching reads; a file ``copy`` of before goes.

    They are three quarters of it, and a walk is mapped from half a dozen copies, each with other pairs.
    """
    copy.unlink(missing_ok=True)
    with closing(sqlite3.connect(copy)) as target:
        # Nobody goes on with a copy that was not finished.
        target.execute("PRAGMA journal_mode = OFF")
        target.execute("PRAGMA synchronous = OFF")
        target.execute("ATTACH DATABASE ? AS source", (str(database),))
        made = target.execute("SELECT type, name, sql FROM source.sqlite_master WHERE sql IS NOT NULL").fetchall()
        # Indices after what they are of; SQLite makes its own tables itself.
        for kind, name, sql in sorted(made, key=lambda one: one[0] != "table"):
            if name.startswith("sqlite_"):
                continue
            target.execute(sql)
            if kind == "table" and name != "descriptors":
                target.execute(f'INSERT INTO main."{name}" SELECT * FROM source."{name}"')
        (version,) = target.execute("PRAGMA source.user_version").fetchone()
        target.execute(f"PRAGMA main.user_version = {version}")
        target.commit()
