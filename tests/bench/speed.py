"""Depth of one view: ``fsinfer`` against vanilla MVSNet in PyTorch, on the same views, in turns.

python -m tests.bench.speed                 1280x704, 5 views, 5 pairs of runs, every core
python -m tests.bench.speed --ours --pairs 9 only ours, with its split by stage
python -m tests.bench.speed --scene SCENE    photographs of a scene, such as saharov32, instead of noise

Vanilla is MVSNet (variance volume of 32 channels, 192 planes, 3D U-Net, soft-argmin) in PyTorch eager, its volume
written out with whole warped volumes (:mod:`tests.bench.vanilla_mvsnet`); ``chunked`` is our own training code, whose
volume is made in chunks that stay in the cache. Weights do not matter for the time. Each side is a process of its own,
so that its peak memory is its own; they work in turns, never at the same time. ``fsinfer`` takes part twice, with its
graphs in float32 and in int8 where the model has them. Beside the clock stand the processor seconds of all threads,
which other programs on the machine disturb less. The photographs are noise, the cameras stand 0.3 m apart in a row:
all pixels are unsure, which ours settles one by one. ``--scene`` takes photographs as they are.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from fsinfer.depth.cost_volume import weighted_correlation_volume
from fsinfer.depth.manifest import read_manifest
from fsinfer.depth.plane_volume import plane_correlation_volume
from fsinfer.depth.settings import DepthSettings
from tests.bench.results import add_result_options, check_result_options, save_result
from tests.bench.scene_views import Views, views_of_scene

GEMM_SIZE = 2048
#: Variables that set threads from outside; no user has them.
NOT_A_USERS = ("OMP_", "OPENBLAS_", "MKL_")
OURS = ("float32", "int8")  # precisions of the graphs
#: MVSNet in PyTorch: with its volume written out, and as the training code has it.
VANILLA, CHUNKED = "vanilla", "chunked"


def make_views(views: int, height: int, width: int) -> Views:
    """N photographs of noise, (N, 3, 3) intrinsics, (N, 4, 4) poses in a row, the depth range in metres."""
    rng = np.random.default_rng(0)
    images = [rng.integers(0, 255, (height, width, 3), dtype=np.uint8) for _ in range(views)]
    intrinsic = np.array([[0.8 * width, 0, width / 2], [0, 0.8 * width, height / 2], [0, 0, 1.0]])
    poses = np.stack([np.eye(4)] * views)
    poses[:, 0, 3] = -0.3 * np.arange(views)
    return images, np.stack([intrinsic] * views), poses, (1.0, 20.0)


def views_of(args: argparse.Namespace) -> Views:
    """Photographs of the scene of the options, or noise."""
    size = (args.views, args.height, args.width)
    return views_of_scene(args.scene, *size) if args.scene else make_views(*size)


def in_pytorch(args: argparse.Namespace) -> Callable[[], dict[str, float]]:
    """One whole depth map by MVSNet in PyTorch."""
    from tests.bench.vanilla_mvsnet import mvsnet

    estimate = mvsnet(views_of(args), args.threads, written_out=args.worker == VANILLA)

    def run() -> dict[str, float]:
        started, busy = time.perf_counter(), time.process_time()
        estimate()
        return {"all": time.perf_counter() - started, "processor": time.process_time() - busy}

    return run


class Timed:
    """A function that notes how long each call took."""

    def __init__(self, work: Callable[..., Any], seconds: dict[str, float], name: str) -> None:
        self._work, self._seconds, self._name = work, seconds, name

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """Call through."""
        started = time.perf_counter()
        try:
            return self._work(*args, **kwargs)
        finally:
            self._seconds[self._name] = self._seconds.get(self._name, 0.0) + time.perf_counter() - started

    run_two = run_parts = __call__  # stands for a graph too


def ours(args: argparse.Namespace, precision: str) -> Callable[[], dict[str, float]]:
    """One whole depth map by fsinfer; ``all`` counts the features of all views, ``cached`` those of one."""
    import cv2

    from fsinfer.depth import model as depth_model
    from fsinfer.depth import narrow_volumes
    from fsinfer.depth.subpixel import normalised
    from fsinfer.depth.surface import SURFACE
    from fsinfer.depth.view_maps import finish_depth
    from fsinfer.threads import in_order

    cv2.setNumThreads(1)  # as the depth stage does
    seconds: dict[str, float] = {}
    model = depth_model.DepthModel.load(args.model, threads=args.threads, precision=precision)
    sessions = model._sessions
    model._sessions = {
        name: session
        if name == "features"
        else Timed(session.run_parts if name == SURFACE else session.run_two, seconds, name)
        for name, session in sessions.items()
    }

    timed = (
        (depth_model, plane_correlation_volume, "volume"),
        (narrow_volumes, weighted_correlation_volume, "narrow volume"),
    )
    for where, work, name in timed:
        patch.object(where, work.__name__, Timed(work, seconds, name)).start()
    images, intrinsics, poses, depth_range = views_of(args)

    settings = DepthSettings()

    def load(images: list[NDArray[np.uint8]]) -> tuple[list[Any], list[Any]]:
        greys = in_order(lambda image: normalised(image, settings.subpixel), images, args.threads)
        return model.features_of(images), list(greys)

    def run() -> dict[str, float]:
        seconds.clear()
        started, busy = time.perf_counter(), time.process_time()
        features, greys = Timed(load, seconds, "features")(images)
        estimate = model.predict_from_features(features, intrinsics, poses, depth_range)
        finish = Timed(finish_depth, seconds, "finish")
        curves = model.manifest.photo_confidence
        finish(estimate, greys, intrinsics, poses, curves=curves, settings=settings, threads=model.threads)
        whole, busy = time.perf_counter() - started, time.process_time() - busy
        split = dict(seconds)
        # Of one view by itself, as in a plot, whose neighbours' features are at hand: not a fifth of those of five.
        seconds.clear()
        Timed(load, seconds, "features")(images[:1])
        one_view = seconds["features"]
        return split | {
            "features of one view": one_view,
            "rest": whole - sum(split.values()),
            "all": whole,
            "processor": busy,
            "cached": whole - split["features"] + one_view,
        }

    return run


def gflop_of(model: Path, inputs: dict[str, NDArray[np.float32]]) -> float:
    """Multiplications and additions (1e9) of the convolutions and matrix products of a graph at these inputs.

    The shapes are those of the results themselves: every convolution is made an output and run once.
    """
    import onnx
    import onnxruntime

    graph = onnx.load(model)
    weights = {item.name: tuple(item.dims) for item in graph.graph.initializer}
    counted = [node for node in graph.graph.node if node.op_type in ("Conv", "MatMul", "Gemm")]
    known = {output.name for output in graph.graph.output}
    for node in counted:
        if node.output[0] not in known:
            graph.graph.output.append(onnx.helper.make_tensor_value_info(node.output[0], onnx.TensorProto.FLOAT, None))
    session = onnxruntime.InferenceSession(graph.SerializeToString(), providers=["CPUExecutionProvider"])
    names = [output.name for output in session.get_outputs()]
    results = dict(zip(names, session.run(names, inputs), strict=True))
    total = 0.0
    for node in counted:
        weight = weights[node.input[1]]
        # (outputs, inputs / groups, kernel ...) of a convolution; (inputs, outputs) or its transpose of a product.
        per_output = (
            np.prod(weight[1:]) if node.op_type == "Conv" else np.prod(weight) / results[node.output[0]].shape[-1]
        )
        total += 2.0 * results[node.output[0]].size * float(per_output)
    return total / 1e9


def gemm_peak_gflops(threads: int) -> float:
    """Best of five products of two 2048x2048 float32 matrices by onnxruntime, 1e9 operations a second."""
    import onnxruntime
    from onnx import TensorProto, helper

    shape = [GEMM_SIZE, GEMM_SIZE]
    graph = helper.make_graph(
        [helper.make_node("MatMul", ["a", "b"], ["c"])],
        "gemm",
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name in "ab"],
        [helper.make_tensor_value_info("c", TensorProto.FLOAT, shape)],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    session = onnxruntime.InferenceSession(model.SerializeToString(), options, providers=["CPUExecutionProvider"])
    matrix = np.random.default_rng(0).random(shape, np.float32)
    return 2 * GEMM_SIZE**3 / min(seconds_of(lambda: session.run(None, {"a": matrix, "b": matrix}), 5)) / 1e9


def seconds_of(work: Callable[[], Any], times: int) -> list[float]:
    """Seconds of each of so many calls."""
    found = []
    for _ in range(times):
        started = time.perf_counter()
        work()
        found.append(time.perf_counter() - started)
    return found


def regularizer_speed(args: argparse.Namespace) -> dict[str, float]:
    """The regularizer by itself: seconds, GFLOP, and its share of the peak of a matrix product."""
    from fsinfer.depth.model import DepthModel

    model = DepthModel.load(args.model, threads=args.threads, precision="float32")
    manifest = model.manifest
    channels = manifest.packed_planes * manifest.groups
    shape = (manifest.planes // manifest.packed_planes, channels, -(-args.height // 4), -(-args.width // 4))
    inputs = {"volume": np.random.default_rng(0).random(shape, np.float32)}
    session = model._sessions["regularizer"]
    session.run(None, inputs)
    peaks, spent = [], []
    for _ in range(3):  # in turns too: a machine's clock drifts
        peaks.append(gemm_peak_gflops(args.threads))
        spent += seconds_of(lambda: session.run(None, inputs), 5)
    gflop = gflop_of(manifest.folder / manifest.regularizer, inputs)
    seconds, peak = float(np.median(spent)), max(peaks)
    return {
        "seconds": seconds,
        "gflop": gflop,
        "gflop_per_s": gflop / seconds,
        "gemm_peak_gflop_per_s": peak,
        "share": gflop / seconds / peak,
    }


def serve(args: argparse.Namespace) -> int:
    """The worker: one run for each line on stdin, one line of JSON for each run."""
    run = ours(args, args.worker) if args.worker in OURS else in_pytorch(args)
    for _ in sys.stdin:
        found = run()
        peak_mib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(json.dumps({"seconds": found, "peak_rss_mib": peak_mib}), flush=True)
    return 0


class Worker:
    """The process of one side."""

    def __init__(self, side: str, args: argparse.Namespace) -> None:
        command = [sys.executable, "-m", "tests.bench.speed", "--worker", side]
        for name in ("views", "height", "width", "threads", "model"):
            command += [f"--{name}", str(getattr(args, name))]
        command += ["--scene", str(args.scene)] if args.scene else []
        # As people start it: what threads there are is the program's business.
        environment = {name: value for name, value in os.environ.items() if not name.startswith(NOT_A_USERS)}
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
        )

    def run(self) -> dict[str, Any]:
        """One depth map."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        return dict(json.loads(self._process.stdout.readline()))

    def close(self) -> None:
        """End it."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait()


def median_of(runs: list[dict[str, Any]], key: str) -> float:
    """Median seconds of one stage."""
    return float(np.median([run["seconds"][key] for run in runs]))


def peak_of(runs: list[dict[str, Any]]) -> float:
    """Largest resident memory of a side, MiB."""
    return max(float(run["peak_rss_mib"]) for run in runs)


def print_rival(rival: str, runs: list[dict[str, Any]]) -> dict[str, float]:
    """Seconds and memory of MVSNet in PyTorch; printed, and as figures."""
    figures = {f"{rival}_{key}_s": median_of(runs, key) for key in ("all", "processor")}
    figures[f"{rival}_peak_mib"] = peak_of(runs)
    for name, value in figures.items():
        print(f"  {name.replace('_', ' '):25s} {value:9.3f}")
    return figures


def print_ratios(side: str, rival: str, theirs: list[dict[str, Any]], mine: list[dict[str, Any]]) -> dict[str, float]:
    """How many times faster, pair by pair: median, least and most; printed, and as figures."""
    figures: dict[str, float] = {}
    than = "" if rival == VANILLA else f"_than_{rival}"
    for theirs_key, key, what in (
        ("all", "all", "features of all views"),
        ("all", "cached", "features of one view, as in a plot"),
        ("processor", "processor", "processor seconds, features of all views"),
    ):
        ratios = [a["seconds"][theirs_key] / b["seconds"][key] for a, b in zip(theirs, mine, strict=True)]
        print(f"  {rival} / {side}, {what}: {np.median(ratios):.1f} ({min(ratios):.1f} to {max(ratios):.1f})")
        figures |= {
            f"{side}_times_faster{than}_{key}": float(np.median(ratios)),
            f"{side}_times_faster{than}_{key}_least": min(ratios),
            f"{side}_times_faster{than}_{key}_most": max(ratios),
        }
    share = peak_of(mine) / peak_of(theirs)
    print(f"  peak memory of {side}: {share:.2f} of that of {rival}")
    return figures | {f"{side}_share_of_{rival}_memory": share}


def main(argv: list[str] | None = None) -> int:
    """Run and print."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.bench.speed", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--pairs", type=int, default=5, help="runs of each side, in turns")
    parser.add_argument("--ours", action="store_true", help="leave vanilla out")
    parser.add_argument("--views", type=int, default=5)
    parser.add_argument("--width", type=int, default=1280)
    parser.add_argument("--height", type=int, default=704)
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--model", default=DepthSettings.model)
    parser.add_argument("--scene", type=Path, help="photographs of a scene in MVSNet format instead of noise")
    parser.add_argument("--worker", choices=(VANILLA, CHUNKED, *OURS), help=argparse.SUPPRESS)
    add_result_options(parser)
    args = parser.parse_args(argv)
    check_result_options(parser, args)
    if args.worker:
        return serve(args)
    precisions = [name for name in OURS if name == "float32" or read_manifest(args.model).int8_regularizer]
    sides = precisions if args.ours else [VANILLA, CHUNKED, *precisions]
    workers = {side: Worker(side, args) for side in sides}
    for side in precisions:
        workers[side].run()  # warm-up: onnxruntime plans its memory in the first run
    runs: dict[str, list[dict[str, Any]]] = {side: [] for side in sides}
    for _ in range(args.pairs):
        for side in sides:
            runs[side].append(workers[side].run())
            if not args.ours:
                print(f"{side}: {runs[side][-1]['seconds']['all']:.2f} s", flush=True)
    for worker in workers.values():
        worker.close()
    figures: dict[str, float] = {"views": args.views, "threads": args.threads, "runs": args.pairs}
    print(f"{args.width}x{args.height}, {args.views} views, {args.threads} threads, {args.pairs} runs, medians")
    for side in precisions:
        for stage in runs[side][0]["seconds"]:
            print(f"  {side}, {stage:22s} {median_of(runs[side], stage):7.3f} s")
            figures[f"{side}_{stage.replace(' ', '_')}_s"] = median_of(runs[side], stage)
        print(f"  {side}, peak memory: {peak_of(runs[side]):.0f} MiB")
        figures[f"{side}_peak_mib"] = peak_of(runs[side])
    for rival in () if args.ours else (VANILLA, CHUNKED):
        figures |= print_rival(rival, runs[rival])
        for side in precisions:
            figures |= print_ratios(side, rival, runs[rival], runs[side])
    found = regularizer_speed(args)
    print(
        f"  regularizer: {found['gflop']:.1f} GFLOP in {found['seconds']:.3f} s = {found['gflop_per_s']:.0f} GFLOP/s, "
        f"matrix product {found['gemm_peak_gflop_per_s']:.0f} GFLOP/s: {100 * found['share']:.0f} %"
    )
    figures |= {f"regularizer_alone_{name}": value for name, value in found.items() if name != "share"}
    figures["regularizer_share_of_product_percent"] = 100 * found["share"]
    save_result(args, figures, module="tests.bench.speed", arguments=argv)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
