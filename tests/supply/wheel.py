"""A wheel that was built: its files are those it lists, and its models those of their manifests."""

from __future__ import annotations

import base64
import csv
import email.message
import email.parser
import hashlib
import tempfile
import zipfile
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path, PurePosixPath

from fsinfer.depth.manifest import read_manifest
from fsinfer.errors import ModelError

#: Where the models lie in the wheel.
MODELS = "fsinfer/models/"


@dataclass(frozen=True)
class Wheel:
    """A wheel; its files are read when they are asked for."""

    path: Path

    @cached_property
    def files(self) -> dict[str, bytes]:
        """The bytes of each file, by its name in the archive."""
        with zipfile.ZipFile(self.path) as archive:
            return {name: archive.read(name) for name in archive.namelist() if not name.endswith("/")}

    @cached_property
    def metadata(self) -> email.message.Message:
        """Name, version, licence and what it needs."""
        return email.parser.BytesParser().parsebytes(self.files[self.info("METADATA")])

    def info(self, name: str) -> str:
        """The name in the archive of a file of its ``.dist-info``."""
        (found,) = (file for file in self.files if file.endswith(f".dist-info/{name}") and file.count("/") == 1)
        return found

    @property
    def models(self) -> dict[str, bytes]:
        """The graphs in it, by file name."""
        return {
            PurePosixPath(name).name: content
            for name, content in self.files.items()
            if name.startswith(MODELS) and name.endswith(".onnx")
        }


def faults(wheel: Wheel) -> list[str]:
    """What differs from the wheel's list of files, or from the manifests of its models."""
    return [*_of_record(wheel), *_of_models(wheel)]


def _of_record(wheel: Wheel) -> list[str]:
    """Files that are not those of RECORD."""
    record = wheel.info("RECORD")
    listed = {row[0]: row[1] for row in csv.reader(wheel.files[record].decode().splitlines()) if row}
    wrong = [f"{name} is listed and not in the wheel" for name in listed if name not in wheel.files]
    for name, content in wheel.files.items():
        digest = base64.urlsafe_b64encode(hashlib.sha256(content).digest()).decode().rstrip("=")
        if name not in listed:
            wrong.append(f"{name} is not listed")
        elif name != record and listed[name] != f"sha256={digest}":
            wrong.append(f"{name} is not the file that is listed")
    return wrong


def _of_models(wheel: Wheel) -> list[str]:
    """Models that are not those of their manifests, graphs without a manifest."""
    wrong: list[str] = []
    manifests = [name for name in wheel.files if name.startswith(MODELS) and name.endswith(".json")]
    if not manifests:
        wrong.append("no model in it")
    known: set[str] = set()
    with tempfile.TemporaryDirectory() as folder:
        for name in [*manifests, *(MODELS + graph for graph in wheel.models)]:
            (Path(folder) / PurePosixPath(name).name).write_bytes(wheel.files[name])
        for name in manifests:
            try:
                # The same check as when a plot is computed.
                manifest = read_manifest(Path(folder) / PurePosixPath(name).name)
            except ModelError as error:
                wrong.append(str(error).replace(folder, wheel.path.name))
                continue
            graphs = {*manifest.files_of(int8=False), *manifest.files_of(int8=True)}
            known |= {graph.name for graph in graphs} | ({manifest.tiles.regularizer} if manifest.tiles else set())
        if not wrong:
            wrong += [f"{graph} belongs to no model" for graph in wheel.models if graph not in known]
    return wrong
