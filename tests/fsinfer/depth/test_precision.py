"""Which numbers the regularizer is computed with, and that int8 gives the depth of float32."""

from __future__ import annotations

import ctypes
import json
import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from fsinfer.depth import precision
from fsinfer.depth.manifest import hash_files, models_folder, read_manifest
from fsinfer.depth.maps import read_depth_index
from fsinfer.depth.model import DepthModel
from fsinfer.depth.precision import choose_precision, is_fast_at_int8
from fsinfer.depth.settings import DepthSettings
from fsinfer.errors import InputError, ModelError
from fsinfer.scene import read_scene
from fsinfer.workflow.single_stages import depth_of
from tests.support.plane_scene import write_plane_scene

X86 = "processor\t: {core}\nmodel name\t: Some CPU\nflags\t\t: fpu sse2 avx {flags}\nbugs\t\t:\n\n"
ARM = "processor\t: {core}\nBogoMIPS\t: 50.00\nFeatures\t: fp asimd {flags}\nCPU part\t: 0xd0c\n\n"


def cpuinfo(text: str, *flags: str) -> str:
    return "".join(text.format(core=core, flags=flag) for core, flag in enumerate(flags))


@pytest.mark.parametrize(
    ("system", "machine", "text", "expected"),
    [
        ("Linux", "x86_64", cpuinfo(X86, "avx2 avx512f avx512_vnni", "avx2 avx512f avx512_vnni"), True),
        ("Linux", "x86_64", cpuinfo(X86, "avx2"), True),
        ("Linux", "x86_64", cpuinfo(X86, "sse4_2"), False),
        ("Linux", "x86_64", cpuinfo(X86, "xavx2 avx2x"), False),
        ("Linux", "x86_64", cpuinfo(X86, "avx2", ""), False),
        ("Linux", "x86_64", cpuinfo(X86, "asimddp"), False),
        ("Linux", "x86_64", "", False),
        ("Linux", "aarch64", cpuinfo(ARM, "asimddp", "asimddp sve"), True),
        ("Linux", "aarch64", cpuinfo(ARM, "crc32"), False),
        ("Linux", "riscv64", cpuinfo(ARM, "asimddp"), False),
        ("Darwin", "arm64", "", True),
        ("Darwin", "x86_64", "", False),
        ("Windows", "AMD64", "", False),
        ("FreeBSD", "amd64", cpuinfo(X86, "avx2"), False),  # nobody has measured there
    ],
)
def test_processors_that_are_fast_at_8_bit_integers(system: str, machine: str, text: str, expected: bool) -> None:
    assert is_fast_at_int8(system, machine, cpuinfo=text) is expected


def test_windows_is_asked_for_avx2() -> None:
    assert is_fast_at_int8("Windows", "AMD64", windows_avx2=True)
    assert not is_fast_at_int8("Windows", "ARM64", windows_avx2=True)
    assert not is_fast_at_int8("Linux", "x86_64", windows_avx2=True)


def test_windows_answers_by_its_own_function(monkeypatch: pytest.MonkeyPatch) -> None:
    for present in (True, False):
        asked: list[int] = []

        def answer(feature: int, asked: list[int] = asked, present: bool = present) -> int:
            asked.append(feature)
            return int(present)

        windll = SimpleNamespace(kernel32=SimpleNamespace(IsProcessorFeaturePresent=answer))
        monkeypatch.setattr(ctypes, "windll", windll, raising=False)
        assert precision._windows_has_avx2() is present
        assert asked == [40]
    monkeypatch.delattr(ctypes, "windll")
    assert not precision._windows_has_avx2()


def test_weights_of_the_int8_graphs_have_seven_bits() -> None:
    onnx = pytest.importorskip("onnx", reason="onnx comes with the extra train")
    field = read_manifest("field")
    files = field.files_of(int8=True)
    assert [file.stem for file in files] == [f"field_{role}_int8" for role in ("features", "regularizer", "refiner")]
    for file in files:
        weights = [onnx.numpy_helper.to_array(item) for item in onnx.load(file).graph.initializer]
        found = [weight for weight in weights if weight.dtype == np.int8 and weight.ndim > 1]
        assert len(found) > 10
        # Two products with 8 bits of the other side have to fit into 16.
        assert max(int(np.abs(weight.astype(int)).max()) for weight in found) * 255 * 2 < 2**15


def test_what_a_model_has_not_in_int8_stays_in_float32(tmp_path: Path) -> None:
    for file in models_folder().glob("field*"):
        shutil.copy(file, tmp_path)
    manifest = tmp_path / "field.json"
    data = json.loads(manifest.read_text(encoding="utf-8"))
    for role in ("features", "refiner"):
        (tmp_path / data["int8"].pop(role)).unlink()
    files = [tmp_path / f"field_{name}.onnx" for name in ("features", "regularizer_int8", "refiner")]
    data["int8"]["sha256"] = hash_files(files)
    manifest.write_text(json.dumps(data), encoding="utf-8")
    assert read_manifest(manifest).files_of(int8=True) == files
    assert DepthModel.load(manifest, precision="int8", threads=1).sha256 == hash_files(files)


@pytest.fixture
def without_int8(tmp_path: Path) -> Path:
    """Manifest of a model as it is exported: float32 alone."""
    for file in models_folder().glob("field*"):
        shutil.copy(file, tmp_path)
    manifest = tmp_path / "field.json"
    data = json.loads(manifest.read_text(encoding="utf-8"))
    del data["int8"]
    for file in tmp_path.glob("*_int8.onnx"):
        file.unlink()
    manifest.write_text(json.dumps(data), encoding="utf-8")
    return manifest


def test_auto_asks_for_the_file_the_processor_and_the_provider(without_int8: Path) -> None:
    field, plain = read_manifest("field"), read_manifest(without_int8)
    assert plain.int8_regularizer is None
    assert choose_precision("auto", field, fast=True) == "int8"
    assert choose_precision("auto", field, provider="CPUExecutionProvider", fast=True) == "int8"
    assert choose_precision("auto", field, fast=False) == "float32"
    assert choose_precision("auto", field, provider="cuda", fast=True) == "float32"
    assert choose_precision("auto", plain, fast=True) == "float32"


def test_what_is_asked_for_goes_before_the_processor(without_int8: Path) -> None:
    field = read_manifest("field")
    assert choose_precision("int8", field, fast=False) == "int8"
    assert choose_precision("float32", field, fast=True) == "float32"
    with pytest.raises(ModelError, match="no int8 regularizer; leave --precision out"):
        DepthModel.load(without_int8, precision="int8")
    with pytest.raises(InputError, match="no precision 'half'; choose one of auto, float32, int8"):
        DepthModel.load("field", precision="half")


def test_the_processor_of_this_machine_decides(monkeypatch: pytest.MonkeyPatch) -> None:
    for fast, expected in ((True, "int8"), (False, "float32")):
        monkeypatch.setattr(precision, "_this_machine_is_fast", lambda fast=fast: fast)
        assert DepthModel.load("field", threads=1).precision == expected


def test_each_precision_has_its_own_hash_and_both_are_checked(tmp_path: Path) -> None:
    field = read_manifest("field")
    assert field.int8_regularizer is not None
    assert field.sha256_of(int8=True) == hash_files(field.files_of(int8=True)) != field.sha256_of(int8=False)
    for file in models_folder().glob("field*"):
        shutil.copy(file, tmp_path)
    graph = tmp_path / field.int8_regularizer
    graph.write_bytes(graph.read_bytes() + b"x")
    with pytest.raises(ModelError, match="damaged or was changed"):
        read_manifest(tmp_path / "field.json")
    graph.unlink()
    with pytest.raises(ModelError, match=r"int8\.onnx'\] missing in"):
        read_manifest(tmp_path / "field.json")


def test_depth_maps_of_two_precisions_are_not_mixed(tmp_path: Path) -> None:
    scene = read_scene(write_plane_scene(tmp_path / "scene", height=75, width=90))
    out = tmp_path / "out"

    def made(wanted: str) -> tuple[str, bool]:
        first = out / "depth" / f"{scene.views[0].name}.pfm"
        before = first.stat().st_mtime_ns if first.is_file() else None
        result = depth_of(scene.folder, out, settings=DepthSettings(precision=wanted, threads=1)).result
        assert read_depth_index(out)["model_sha256"] == result.model_sha256
        return result.precision, first.stat().st_mtime_ns != before

    assert made("float32") == ("float32", True)
    assert made("float32") == ("float32", False)
    assert made("int8") == ("int8", True)
    assert made("float32") == ("float32", True)
