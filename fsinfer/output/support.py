"""The support zip: what somebody else needs to see why a plot failed, without the photographs and without paths.

It holds the tables and records of an output folder and a text on the computer. Folders of the user's computer are cut
off every path, and the user's name is replaced; names of photographs stay, because warnings speak of them.
"""

from __future__ import annotations

import ctypes
import getpass
import json
import os
import platform
import re
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

from fsinfer.errors import InputError
from fsinfer.io.files import atomic_path
from fsinfer.io.json_text import parse_json
from fsinfer.output.layout import LOG_FILE
from fsinfer.output.plot_json import package_versions

SYSTEM_FILE = "system.txt"
# Each of them tells that the folder is an output folder; a single stage writes its files without the stage's folder.
_RECORDS = (
    "plot.json",
    "trees.csv",
    "trees.json",
    "dbh_sources.csv",
    "edits.csv",
    "scale_clicks.json",
    LOG_FILE,
    "frames.csv",
    "frames.json",
    "poses.json",
    "frames/frames.csv",
    "frames/frames.json",
    "scene/poses.json",
    "depth/depth.json",
    "check/check.json",
)
# Hand-written or of any origin: packed, but no sign of an output folder.
_NO_SIGN = frozenset({"edits.csv", "scale_clicks.json"})
_STAGE_RECORDS = ".fsinfer/*.json"
_CONTACT_SHEETS = ("frames/frames_contact.jpg", "frames_contact.jpg")
# The first that is there: frames are what the later stages saw.
_PHOTO_FOLDERS = ("frames/images", "images", "scene/images")

# The folders of an absolute path, blanks included, up to its last part. Blanks may take words of a sentence with them;
# for a folder with a blank in its name to stay would be worse.
_FOLDERS = r"(?:[^/\\:;,\"'<>|\n]+[/\\]+)"
_POSIX_FOLDERS = re.compile(rf"(?<![\w./~\\-])/(?=[^\s/]){_FOLDERS}+")
_WINDOWS_FOLDERS = re.compile(rf"(?:(?<!\w)[A-Za-z]:[\\/]+|\\\\(?=\w)){_FOLDERS}*")
#: Shorter names are too often a part of something else, letters. Source: judgement.
_MIN_NAME_LENGTH = 3
# Names of accounts that say nothing of a person.
_ANYBODY = frozenset({"root", "user", "admin", "administrator", "ubuntu", "runner"})


def write_support_zip(out: Path, target: Path, *, photos: bool = False) -> Path:
    """Pack what is known of a run into a zip file to send.

    It holds, as far as they are there: ``plot.json``, ``trees.csv``, ``trees.json``, ``dbh_sources.csv``,
    ``edits.csv``, the frames' table and contact sheet, the records of the stages, of the poses, of the depth and of the
    check, and ``fsinfer.log``; and always ``system.txt``: versions, platform, processor and memory.

    Parameters
    ----------
    out: output folder of a run or of a single stage, finished or not.
    target: the zip file to write; one that is there is replaced.
    photos: put the photographs (the chosen frames) in as well. Without it the contact sheet, small pictures of frames,
        is the only picture.

    Returns
    -------
    ``target``.

    Raises
    ------
    InputError
        ``out`` holds nothing that fsinfer wrote.
    OutputError
        ``target`` cannot be written.
    """
    records = [out / name for name in _RECORDS if (out / name).is_file()]
    records += sorted(out.glob(_STAGE_RECORDS))
    if not any(path.relative_to(out).as_posix() not in _NO_SIGN for path in records):
        msg = f"{out} is no output folder of fsinfer; give the folder that was given to fsinfer run"
        raise InputError(msg)
    pictures = [out / name for name in _CONTACT_SHEETS if (out / name).is_file()]
    if photos:
        pictures += _photographs(out)
    scrub = scrubber(out)
    unread: list[str] = []
    with atomic_path(target) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in records:
            content = _content(path, unread)
            if content is not None:
                archive.writestr(path.relative_to(out).as_posix(), _scrubbed(content, path.suffix, scrub))
        for path in pictures:
            content = _content(path, unread)
            if content is not None:
                # Photographs are compressed already.
                archive.writestr(path.relative_to(out).as_posix(), content, compress_type=zipfile.ZIP_STORED)
        missing = [name for name in _RECORDS if not (out / name).is_file()]
        archive.writestr(SYSTEM_FILE, scrub(system_text(missing=missing, unread=unread)))
    return target


def system_text(*, missing: list[str], unread: list[str]) -> str:
    """Versions, platform, processor and memory of this computer, a line each."""
    versions = "".join(f"  {name} {version or 'not installed'}\n" for name, version in package_versions().items())
    memory_gb = total_memory_gb()
    memory = "not known" if memory_gb is None else f"{memory_gb:.1f} GB"
    return (
        f"platform: {platform.platform()}\n"
        f"processor: {processor_name()}, {os.cpu_count()} logical cores\n"
        f"memory: {memory}\n"
        f"versions:\n{versions}"
        f"not in the folder: {', '.join(missing) or 'nothing'}\n"
        f"could not be read: {', '.join(unread) or 'nothing'}\n"
    )


def processor_name(cpuinfo: Path = Path("/proc/cpuinfo")) -> str:
    """The processor's name as the system tells it."""
    try:
        found = re.search(r"^model name\s*:\s*(.+)$", cpuinfo.read_text(encoding="utf-8"), flags=re.MULTILINE)
    except OSError:
        found = None
    return found[1].strip() if found else platform.processor() or platform.machine()


def total_memory_gb() -> float | None:
    """Main memory in GB (1e9 bytes); None where the system does not tell."""
    if sys.platform == "win32":
        return _windows_memory_gb()
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 1e9
    except (OSError, ValueError):
        return None


def scrubber(out: Path) -> Callable[[str], str]:
    """Return a function that cuts folders off absolute paths in a text and replaces the user's name."""
    # Longest first, so that a home folder does not leave the rest of a longer path standing.
    folders = {str(folder) for folder in (Path.home(), out.resolve().parent, Path.cwd()) if len(folder.parts) > 1}
    ordered = sorted(folders, key=len, reverse=True)
    known = [re.compile(rf"{re.escape(folder)}(?:[/\\]+{_FOLDERS}*|(?![\w.-]))") for folder in ordered]
    names = {name for name in (_user_name(), Path.home().name) if name.lower() not in _ANYBODY}
    # A whole word: a photograph called anna_01.jpg keeps its name, which the tables speak of.
    people = [
        re.compile(rf"(?<![\w.-]){re.escape(name)}(?![\w-]|\.\w)", flags=re.IGNORECASE)
        for name in names
        if len(name) >= _MIN_NAME_LENGTH
    ]

    def scrub(text: str) -> str:
        for folder in known:
            text = folder.sub("", text)
        text = _POSIX_FOLDERS.sub("", _WINDOWS_FOLDERS.sub("", text))
        for person in people:
            text = person.sub("user", text)
        return text

    return scrub


def _scrubbed(content: bytes, suffix: str, scrub: Callable[[str], str]) -> bytes:
    """File content without the user's folders and name; the same bytes where there were none."""
    # A log that was cut in the middle of a letter is worth reading all the same.
    text = content.decode("utf-8", errors="replace")
    if suffix == ".json":
        try:
            value = parse_json(text)
        except ValueError:
            pass
        else:
            clean = _scrub_json(value, scrub)
            return content if clean == value else json.dumps(clean, indent=1, ensure_ascii=False).encode()
    clean_text = scrub(text)
    return content if clean_text == text else clean_text.encode()


def _scrub_json(value: Any, scrub: Callable[[str], str]) -> Any:
    # In JSON text backslashes stand twice, and keys are words that a name may be equal to: so value by value.
    if isinstance(value, dict):
        return {key: _scrub_json(item, scrub) for key, item in value.items()}
    if isinstance(value, list):
        return [_scrub_json(item, scrub) for item in value]
    if not isinstance(value, str):
        return value
    if not re.search(r"\s", value):
        # All of it may be a path; without blanks it is no sentence, and commas in it end nothing.
        for kind in (PureWindowsPath, PurePosixPath):
            value = kind(value).name if kind(value).is_absolute() else value
    return scrub(value)


def _photographs(out: Path) -> list[Path]:
    folder = next((out / name for name in _PHOTO_FOLDERS if (out / name).is_dir()), None)
    return [] if folder is None else sorted(path for path in folder.iterdir() if path.is_file())


def _content(path: Path, unread: list[str]) -> bytes | None:
    try:
        return path.read_bytes()
    except OSError as error:
        unread.append(f"{path.name} ({error.strerror})")
        return None


def _user_name() -> str:
    try:
        return getpass.getuser()
    except (ImportError, KeyError, OSError):
        # No such entry in the table of users, as in some containers.
        return ""


def _windows_memory_gb() -> float | None:
    class _Status(ctypes.Structure):
        _fields_ = (
            ("length", ctypes.c_ulong),
            ("load", ctypes.c_ulong),
            *(
                (name, ctypes.c_ulonglong)
                for name in ("total", "free", "page", "page_free", "virtual", "v_free", "ext")
            ),
        )

    status = _Status()
    status.length = ctypes.sizeof(_Status)
    kernel = getattr(ctypes, "windll", None)
    if kernel is None or not kernel.kernel32.GlobalMemoryStatusEx(ctypes.byref(status)):
        return None
    return float(status.total) / 1e9
