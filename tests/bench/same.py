"""Same photographs, same trees? ``python -m tests.bench.same WORK [--photos 36] [--emulator 'qemu-x86_64 -cpu max']``.

The installed command measures the first photographs of the demo plot again and again: undisturbed, once more, on one
core, beside two busy programs (these two are timed, and nothing else may run), with OpenCV's, NumPy's and OpenBLAS's
code for AVX2, and with the depth network in float32, as it runs where a processor has no 8-bit dot products. Each
``trees.csv`` is held against the first, stems matched by their place. onnxruntime cannot be told to leave AVX-512
alone; with ``--emulator`` (Linux on x86-64; Debian has ``qemu-user``) the depth maps of a few of these photographs,
small ones, are computed by this machine and by an emulated processor with AVX2 only, both in float32. What is done is
kept in WORK and not repeated.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fsinfer.evaluation.registration import assign
from fsinfer.io.pfm import read_pfm
from fsinfer.scene import read_scene, write_camera, write_pairs
from fsinfer.trees import Tree
from fsinfer.trees.outputs.table import read_trees
from tests.bench.demo import demo_photos, user_environment
from tests.bench.results import add_result_options, check_result_options, save_result

#: Stems of two runs nearer than this are one. The demo's stand metres apart.
SAME_STEM_M = 0.3
#: Side of the demo's boards.
BOARD_M = 0.25
#: What OpenBLAS, OpenCV and NumPy are told to leave alone.
AVX2_LIBRARIES = {
    "OPENBLAS_CORETYPE": "Haswell",
    "OPENCV_CPU_DISABLE": "AVX512_SKX,AVX512_CNL,AVX512_CLX,AVX512_ICL",
    "NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL AVX512_SPR",
}
#: Photographs and longer side for the emulated processor, which takes half a minute for each.
EMULATED_PHOTOS, EMULATED_PX = 6, 320


@dataclass(frozen=True, kw_only=True)
class Way:
    """How a run differs from the first: variables set, options given, cores allowed, busy programs beside it."""

    variables: Mapping[str, str] = field(default_factory=dict)
    options: tuple[str, ...] = ()
    cores: int | None = None
    hogs: int = 0


WAYS: Mapping[str, Way] = {
    "first": Way(),
    "again": Way(),
    "one_core": Way(cores=1),
    "hogs": Way(hogs=2),
    "avx2_libraries": Way(variables=AVX2_LIBRARIES),
    "float32": Way(options=("--precision", "float32")),
}


def main(argv: list[str] | None = None) -> int:
    """Run, compare, print."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.same", description=__doc__)
    parser.add_argument("work", type=Path)
    parser.add_argument("--photos", type=int, default=36, help="the first so many of the demo's photos")
    parser.add_argument("--only", nargs="*", default=list(WAYS), choices=list(WAYS))
    parser.add_argument("--emulator", type=shlex.split, help="a command that emulates a processor with AVX2 only")
    add_result_options(parser)
    args = parser.parse_args(argv)
    check_result_options(parser, args)
    photos = demo_photos(args.work / "photos", args.photos)
    seconds = {name: measured(photos, args.work / name, WAYS[name]) for name in dict.fromkeys(["first", *args.only])}
    first = read_trees(args.work / "first" / "trees.csv")
    figures: dict[str, float | None] = {"photos": len(list(photos.iterdir())), "cores": os.cpu_count()}
    for name in seconds:
        out = args.work / name
        same = (out / "trees.csv").read_bytes() == (args.work / "first" / "trees.csv").read_bytes()
        row = {"identical": float(same), **differences(first, read_trees(out / "trees.csv"))}
        if WAYS[name].hogs or WAYS[name].cores:
            row["time_ratio"] = seconds[name] / seconds["first"]
        figures |= {f"{name}_{key}": value for key, value in row.items()}
    if args.emulator:
        figures |= emulated(args.work, args.emulator)
    for name, value in figures.items():
        print(f"{name:32s} {value}")
    save_result(args, figures, module="tests.bench.same", arguments=argv)
    return 0


def measured(photos: Path, out: Path, way: Way) -> float:
    """Run ``fsinfer run`` in this way, or take what is there; seconds by the clock."""
    kept = out / "clock.json"
    if kept.is_file():
        return float(json.loads(kept.read_text(encoding="utf-8")))
    shutil.rmtree(out, ignore_errors=True)
    command = [str(Path(sys.executable).with_name("fsinfer")), "run", str(photos.resolve()), str(out.resolve())]
    command += ["--aruco-length-m", str(BOARD_M), "--quiet", *way.options]
    allowed = None if way.cores is None else set(sorted(os.sched_getaffinity(0))[: way.cores])
    with busy_programs(way.hogs):
        start = time.perf_counter()
        subprocess.run(
            command,
            env=user_environment() | dict(way.variables),
            cwd=photos.parent,
            check=True,
            preexec_fn=None if allowed is None else lambda: os.sched_setaffinity(0, allowed),
        )
        clock_s = time.perf_counter() - start
    kept.write_text(json.dumps(clock_s), encoding="utf-8")
    return clock_s


@contextmanager
def busy_programs(count: int) -> Iterator[None]:
    """So many programs that do nothing but count, in this session of the system, as a user's other programs are."""
    programs = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for program in programs:
            program.kill()
            program.wait()


def differences(first: Sequence[Tree], other: Sequence[Tree]) -> dict[str, float]:
    """What the worst stem of two runs differs by.

    Stems are matched by their place alone, within ``SAME_STEM_M``.
    ``unmatched`` counts those of both runs without a partner, ``changed`` those whose status differs or that have a
    DBH in one run only; lengths are centimetres, of the place millimetres.
    """
    places, others = (np.array([[t.x_m, t.y_m] for t in trees]).reshape(-1, 2) for trees in (first, other))
    pairs = assign(places, others, SAME_STEM_M)
    both = [(first[i], other[j]) for i, j in pairs]
    worst = {"dbh_cm": 0.0, "half_width_cm": 0.0, "place_mm": 0.0}
    changed = 0
    for a, b in both:
        changed += a.status != b.status or (a.dbh_cm is None) != (b.dbh_cm is None)
        place_mm = 1000 * float(np.hypot(a.x_m - b.x_m, a.y_m - b.y_m))
        worst["place_mm"] = max(worst["place_mm"], place_mm)
        if a.dbh_cm is not None and b.dbh_cm is not None:
            worst["dbh_cm"] = max(worst["dbh_cm"], abs(a.dbh_cm - b.dbh_cm))
        if np.isfinite([a.half95_cm, b.half95_cm]).all():
            worst["half_width_cm"] = max(worst["half_width_cm"], abs(a.half95_cm - b.half95_cm))
    unmatched = len(first) + len(other) - 2 * len(both)
    return {"stems": len(first), "unmatched": unmatched, "changed": changed} | worst


def emulated(work: Path, emulator: Sequence[str]) -> dict[str, float | None]:
    """Depth maps of this processor and of an emulated one, in float32: relative differences, and of the confidence."""
    scene = work / "few"
    few_views(work / "first" / "scene", scene, EMULATED_PHOTOS)
    for name, before in (("native", ()), ("emulated", tuple(emulator))):
        command = [*before, sys.executable, "-m", "fsinfer", "depth", str(scene), str(work / name), "--quiet"]
        command += ["--precision", "float32", "--max-size", str(EMULATED_PX)]
        subprocess.run(command, env=user_environment(), check=True)
    depth = compared(work / "native" / "depth", work / "emulated" / "depth", relative=True)
    confidence = compared(work / "native" / "confidence", work / "emulated" / "confidence", relative=False)
    return {
        "emulated_maps": EMULATED_PHOTOS,
        "emulated_pixels": depth.size,
        "emulated_depth_median": float(np.median(depth)),
        "emulated_depth_p999": float(np.quantile(depth, 0.999)),
        "emulated_depth_worst": float(depth.max()),
        "emulated_confidence_worst": float(confidence.max()),
    }


def few_views(scene: Path, few: Path, count: int) -> None:
    """A scene of the first ``count`` views of another, each with the next of them as its sources."""
    views = read_scene(scene).views[:count]
    for view in views:
        (few / "images").mkdir(parents=True, exist_ok=True)
        shutil.copy(view.image_path, few / "images")
        write_camera(few / "cams" / f"{view.name}_cam.txt", view.camera)
    near = {i: sorted((j for j in range(len(views)) if j != i), key=lambda j: abs(i - j)) for i in range(len(views))}
    write_pairs(few / "pair.txt", {i: [(j, 1.0 / abs(i - j)) for j in others] for i, others in near.items()})


def compared(first: Path, other: Path, *, relative: bool) -> NDArray[np.float64]:
    """Absolute differences of all maps of two folders, (pixels,), of ``first`` where relative."""
    found = []
    for path in sorted(first.glob("*.pfm")):
        a, b = (np.asarray(read_pfm(p), float).ravel() for p in (path, other / path.name))
        found.append(np.abs(a - b) / (np.abs(a) if relative else 1.0))
    return np.concatenate(found)


if __name__ == "__main__":
    raise SystemExit(main())
