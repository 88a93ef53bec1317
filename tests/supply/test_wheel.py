"""A wheel's models are those of their manifests; its list of parts has them all."""

from __future__ import annotations

import base64
import hashlib
import json
import zipfile
from pathlib import Path

import pytest

from fsinfer.depth.manifest import models_folder
from tests.supply.installed import closure, installed
from tests.supply.sbom import write_sbom
from tests.supply.wheel import Wheel, faults

INFO = "fsinfer-0.1.0.dist-info"
METADATA = "Metadata-Version: 2.4\nName: fsinfer\nVersion: 0.1.0\nLicense-Expression: Apache-2.0\n\n"


def contents() -> dict[str, bytes]:
    """A wheel of the models alone."""
    models = {f"fsinfer/models/{path.name}": path.read_bytes() for path in models_folder().iterdir() if path.is_file()}
    assert sum(name.endswith(".onnx") for name in models) >= 5
    return {"fsinfer/__init__.py": b"", **models, f"{INFO}/METADATA": METADATA.encode()}


def record(files: dict[str, bytes]) -> bytes:
    lines = []
    for name, content in files.items():
        digest = base64.urlsafe_b64encode(hashlib.sha256(content).digest()).decode().rstrip("=")
        lines.append(f"{name},sha256={digest},{len(content)}")
    return "\n".join([*lines, f"{INFO}/RECORD,,", ""]).encode()


def write_wheel(path: Path, files: dict[str, bytes], listed: bytes | None = None) -> Wheel:
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
        archive.writestr(f"{INFO}/RECORD", record(files) if listed is None else listed)
    return Wheel(path)


def test_a_sound_wheel_has_no_faults(tmp_path: Path) -> None:
    assert faults(write_wheel(tmp_path / "a.whl", contents())) == []


@pytest.mark.parametrize("name", sorted(path.name for path in models_folder().glob("*.onnx")))
def test_one_other_byte_in_a_model_is_seen(tmp_path: Path, name: str) -> None:
    files = contents()
    listed = record(files)
    content = bytearray(files[f"fsinfer/models/{name}"])
    content[len(content) // 2] ^= 1
    files[f"fsinfer/models/{name}"] = bytes(content)
    # Also where the list of files was made after the damage.
    (fault,) = faults(write_wheel(tmp_path / "b.whl", files))
    assert "b.whl is damaged or was changed" in fault
    assert f"fsinfer/models/{name} is not the file that is listed" in faults(
        write_wheel(tmp_path / "c.whl", files, listed)
    )


def test_files_too_many_or_too_few_are_seen(tmp_path: Path) -> None:
    files = contents()
    listed = record(files)
    more = {**files, "fsinfer/models/stray.onnx": b"?"}
    assert faults(write_wheel(tmp_path / "a.whl", more)) == ["stray.onnx belongs to no model"]
    assert "fsinfer/models/stray.onnx is not listed" in faults(write_wheel(tmp_path / "b.whl", more, listed))
    without = {name: content for name, content in files.items() if not name.endswith("field_refiner.onnx")}
    wrong = faults(write_wheel(tmp_path / "c.whl", without, listed))
    assert wrong[0] == "fsinfer/models/field_refiner.onnx is listed and not in the wheel"
    assert "field_refiner.onnx" in wrong[1]
    assert "missing" in wrong[1]
    bare = {name: content for name, content in files.items() if "/models/" not in name}
    assert faults(write_wheel(tmp_path / "d.whl", bare)) == ["no model in it"]


def test_the_list_of_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    wheel = write_wheel(tmp_path / "fsinfer.whl", contents())
    packages = installed()
    write_sbom(wheel, packages, tmp_path / "a.json")
    write_sbom(wheel, packages, tmp_path / "b.json")
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()
    told = json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))
    assert (told["bomFormat"], told["specVersion"]) == ("CycloneDX", "1.6")
    assert told["serialNumber"].startswith("urn:uuid:")
    assert told["metadata"]["timestamp"].startswith("2023-11-14")
    root = told["metadata"]["component"]
    assert (root["name"], root["version"], root["purl"]) == ("fsinfer", "0.1.0", "pkg:pypi/fsinfer@0.1.0")
    assert root["hashes"] == [{"alg": "SHA-256", "content": hashlib.sha256(wheel.path.read_bytes()).hexdigest()}]
    assert root["licenses"] == [{"expression": "Apache-2.0"}]
    models = {c["name"]: c["hashes"][0] for c in told["components"] if c["type"] == "machine-learning-model"}
    assert models == {
        path.name: {"alg": "SHA-256", "content": hashlib.sha256(path.read_bytes()).hexdigest()}
        for path in models_folder().glob("*.onnx")
    }
    needs = closure(packages, "fsinfer")
    libraries = {c["name"]: c for c in told["components"] if c["type"] == "library"}
    assert set(libraries) == set(needs) - {"fsinfer"}
    assert all(c["version"] and c["purl"].startswith("pkg:pypi/") and c["licenses"] for c in libraries.values())
    below = {entry["ref"]: entry.get("dependsOn", []) for entry in told["dependencies"]}
    names = {c["bom-ref"]: c["name"] for c in told["components"]}
    assert {names[ref] for ref in below[root["bom-ref"]]} == set(models) | needs["fsinfer"]  # type: ignore[index]
    assert {names[ref] for ref in below[libraries["scipy"]["bom-ref"]]} == {"numpy"}
    # Whoever is named is described.
    assert {ref for refs in below.values() for ref in refs} <= set(names)
