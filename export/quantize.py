"""The graphs in 8-bit integers: ``python -m export.quantize models/field.json --scene SCENE --scene SCENE``.

Static quantization in ONNX's QDQ form: weights symmetric with a scale for each output channel, activations with a scale
and a zero point for each tensor (Jacob et al. 2018, "Quantization and Training of Neural Networks for Efficient
Integer-Arithmetic-Only Inference"). The scales come from photographs and cost volumes of real views, so no training is
needed.
"""

from __future__ import annotations

import argparse
import json
import logging
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import onnx
from numpy.typing import NDArray
from onnxruntime.quantization import CalibrationDataReader, CalibrationMethod, QuantFormat, QuantType, quantize_static
from onnxruntime.quantization.shape_inference import quant_pre_process

from export.hashes import rehash
from export.image_levels import IMAGES, take_levels
from export.map_levels import give_levels
from export.tidy import makers_of
from fsinfer.depth.manifest import read_manifest
from fsinfer.depth.model import DepthEstimate, DepthModel
from fsinfer.depth.narrow_volumes import candidate_volume, refiner_volume
from fsinfer.depth.network_input import network_input
from fsinfer.depth.settings import DepthSettings
from fsinfer.depth.view_group import ViewGroup
from fsinfer.depth.view_maps import load_view, reduced_image, search_range
from fsinfer.errors import FsinferError, SceneError
from fsinfer.scene import Scene, View, read_scene

Float32 = NDArray[np.float32]
#: Inputs of a graph by their names.
Feeds = Mapping[str, Float32]

METHODS = {
    "minmax": CalibrationMethod.MinMax,
    "percentile": CalibrationMethod.Percentile,
    "entropy": CalibrationMethod.Entropy,
}


@dataclass(frozen=True, kw_only=True)
class QuantizeSettings:
    """How the graphs are quantized.

    Attributes
    ----------
    method: key of :data:`METHODS`: how a tensor's range is taken from the calibration. Source:
        compared with others on four volumes, docs/speed.md.
    operators: kinds of nodes that are computed in int8, or only hand int8 on. Source: what the graphs are made of.
    keep_float: convolutions whose weights' names hold one of these stay in float32. What gives the scores of the
        planes always does: the depth is read off their differences. Source: option.
    weight_bits: 8, or 7, with which two products fit into the 16 bits in which processors with AVX2 and no VNNI add
        them up. Source: numerics; 255 * 64 * 2 < 2^15.
    window_px: rows and columns of the middle of each volume that are looked at, at a quarter of the image's resolution;
        twice as many of the narrow volume at half of it, and whole photographs. Source: numerics.
    """

    method: str = "minmax"
    operators: tuple[str, ...] = ("Conv", "Add", "Concat", "Relu")
    keep_float: tuple[str, ...] = ()
    weight_bits: int = 7
    window_px: tuple[int, int] = (64, 96)


@dataclass(frozen=True, kw_only=True)
class Difference:
    """int8 against float32 over the pixels of some views.

    index_median, index_beyond_1: |difference| of the plane index, and the share of pixels beyond one plane.
    depth_median_rel, depth_beyond_1pct: the same of the finished depth where the confidence exceeds 0.5.
    """

    views: int
    index_median: float
    index_beyond_1: float
    depth_median_rel: float
    depth_beyond_1pct: float


class _Feeds(CalibrationDataReader):  # type: ignore[misc]
    def __init__(self, feeds: Sequence[Feeds]) -> None:
        self._feeds = iter(feeds)

    def get_next(self) -> Feeds | None:
        return next(self._feeds, None)


def quantize(model: Path, target: Path, feeds: Sequence[Feeds], settings: QuantizeSettings) -> None:
    """Write the graph ``model`` in int8 to ``target``, with the ranges that these inputs of it give.

    The same inputs give the same file.
    """
    with tempfile.TemporaryDirectory() as folder:
        prepared = Path(folder) / "prepared.onnx"
        # Shapes of every tensor; those that depend on the picture stay open.
        quant_pre_process(str(model), str(prepared), skip_symbolic_shape=True)
        graph = onnx.load(prepared).graph
        quantize_static(
            str(prepared),
            str(target),
            _Feeds(feeds),
            quant_format=QuantFormat.QDQ,
            per_channel=True,
            activation_type=QuantType.QUInt8,
            weight_type=QuantType.QInt8,
            reduce_range=settings.weight_bits < 8,
            op_types_to_quantize=list(settings.operators),
            nodes_to_exclude=[
                *_results(graph),
                *(
                    node.name
                    for node in graph.node
                    if any(part in name for part in settings.keep_float for name in node.input[1:2])
                ),
            ],
            calibrate_method=METHODS[settings.method],
        )
    quantized = onnx.load(target)
    _read_sizes_before(quantized.graph)
    if any(item.name == IMAGES for item in quantized.graph.input):
        # Sizes of tensors in between that change.
        del quantized.graph.value_info[:]
        notes = take_levels(quantized) | give_levels(quantized)
        onnx.helper.set_model_props(quantized, notes)
    onnx.checker.check_model(quantized, full_check=True)
    onnx.save(quantized, target)


def _read_sizes_before(graph: onnx.GraphProto) -> None:
    """Let sizes be read off a tensor before it is quantized: it would be turned back into float32 for nothing else."""
    makers = makers_of(graph)
    for node in graph.node:
        if node.op_type == "Shape":
            maker = makers.get(node.input[0])
            while maker is not None and maker.op_type in ("DequantizeLinear", "QuantizeLinear"):
                node.input[0] = maker.input[0]
                maker = makers.get(node.input[0])


def score_nodes(graph: onnx.GraphProto) -> list[onnx.NodeProto]:
    """The nodes whose result, reshaped, the best plane is looked up in."""
    makers, found = makers_of(graph), []
    for node in graph.node:
        if node.op_type == "ArgMax":
            maker = makers[node.input[0]]
            while maker.op_type in ("Reshape", "Gather", "Squeeze"):
                maker = makers[maker.input[0]]
            found.append(maker)
    return found


def _results(graph: onnx.GraphProto) -> list[str]:
    """Names of the nodes whose result, reshaped, the best plane is looked up in, and of all that is read off them.

    A plane's index is a sum over a probability: with that in 8 bits it would be wrong by a fifth of a plane.
    """
    scores = score_nodes(graph)
    found = [node.name for node in scores]
    read = {output for node in scores for output in node.output}
    for node in graph.node:  # in the order of computation
        if read.intersection(node.input):
            read.update(node.output)
            found.append(node.name)
    return found


def choose_views(scene: Scene, count: int, *, between: bool = False) -> list[View]:
    """Views with sources, spread evenly over the scene; ``between`` gives those in the gaps of the others."""
    usable = [view for view in scene.views if view.sources]
    if len(usable) < 2 * count:
        msg = f"{scene.folder} has {len(usable)} views with sources, {2 * count} are needed to calibrate and to compare"
        raise SceneError(msg)
    step = len(usable) / count
    return [usable[int((i + (0.5 if between else 0.0)) * step)] for i in range(count)]


def window_of(volume: Float32, window_px: tuple[int, int]) -> Float32:
    """The middle of a volume (..., h, w)."""
    starts = [max(0, (size - wanted) // 2) for size, wanted in zip(volume.shape[-2:], window_px, strict=True)]
    rows, columns = (slice(start, start + wanted) for start, wanted in zip(starts, window_px, strict=True))
    return np.ascontiguousarray(volume[..., rows, columns])


def inputs_of_graphs(
    model: DepthModel, scene: Scene, views: Sequence[View], window_px: tuple[int, int]
) -> Iterator[dict[str, Feeds]]:
    """What each graph is given for a view, by its role, made as the depth stage does; of volumes the middle."""
    rows, columns = window_px
    for view in views:
        image, _, _ = reduced_image(view, DepthSettings())
        group = _group(model, scene, view)
        volume, weights = model.cost_volume(group)
        feeds: dict[str, Feeds] = {
            "features": {"images": network_input(image)},
            "regularizer": {"volume": window_of(volume, window_px)},
        }
        if weights is not None and model.manifest.refiner is not None:
            index, confidence = model.regularize(volume)
            if model.manifest.candidates is not None:
                given, weights = candidate_volume(
                    model.manifest, group, index, confidence, weights, threads=model.threads
                )
                feeds["candidates"] = {name: window_of(part, window_px) for name, part in given.items()}
                index, _ = model.choose(given, confidence)
            narrow, _ = refiner_volume(model.manifest, group, index, weights, threads=model.threads)
            feeds["refiner"] = {name: window_of(part, (2 * rows, 2 * columns)) for name, part in narrow.items()}
        yield feeds


def compare(manifest: Path, scenes: Sequence[Scene], count: int) -> Difference:
    """Difference between the two precisions on views that did not calibrate."""
    models = [DepthModel.load(manifest, precision=precision, calibrate=False) for precision in ("float32", "int8")]
    index: list[Float32] = []
    depth: list[Float32] = []
    views = 0
    for scene in scenes:
        for view in choose_views(scene, count, between=True):
            groups = [_group(model, scene, view) for model in models]
            both = list(zip(models, groups, strict=True))
            made = [model.regularize(model.cost_volume(group)[0]) for model, group in both]
            index.append(np.abs(made[1][0] - made[0][0]).ravel())
            exact, quick = (model.estimate(group) for model, group in both)
            depth.append(_relative(exact, quick))
            views += 1
    all_index, all_depth = np.concatenate(index), np.concatenate(depth)
    return Difference(
        views=views,
        index_median=float(np.median(all_index)),
        index_beyond_1=float((all_index > 1).mean()),
        depth_median_rel=float(np.median(all_depth)),
        depth_beyond_1pct=float((all_depth > 0.01).mean()),
    )


def add_to_manifest(
    path: Path, int8: Mapping[str, Path], settings: QuantizeSettings, scenes: Sequence[str], views: int
) -> None:
    """Enter the int8 graphs by their roles, the hash with them, and how they were made."""
    data = read_manifest(path).details
    data["int8"] = {
        **{role: file.name for role, file in int8.items()},
        "method": settings.method,
        "operators": list(settings.operators),
        "keep_float": list(settings.keep_float),
        "weight_bits": settings.weight_bits,
        "window_px": list(settings.window_px),
        "calibration": {"scenes": list(scenes), "views": views},
    }
    rehash(data, path.parent)
    path.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")


def drop_from_manifest(path: Path) -> None:
    """Take the entry of the int8 graphs out, so that the model can be read while they are replaced."""
    data = json.loads(path.read_text(encoding="utf-8"))
    if data.pop("int8", None) is not None:
        path.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")


def _group(model: DepthModel, scene: Scene, view: View) -> ViewGroup:
    """A view and its sources, with the depth range that is searched, as in the depth stage."""
    settings = DepthSettings()
    group = [view, *(scene.views[i] for i in view.sources[: settings.source_views])]
    loaded = [load_view(model, v, settings) for v in group]
    searched = search_range(
        view.camera.depth_min, view.camera.depth_max, settings, inverse_depth=model.manifest.inverse_depth
    )
    intrinsics = np.stack([item.intrinsic for item in loaded])
    poses = np.stack([v.camera.cam_from_world for v in group])
    return ViewGroup.of([item.features for item in loaded], intrinsics, poses, searched)


def _relative(wanted: DepthEstimate, found: DepthEstimate) -> Float32:
    sure = wanted.confidence > 0.5
    return np.asarray(np.abs(found.depth[sure] / wanted.depth[sure] - 1), np.float32)


def main(arguments: list[str] | None = None) -> int:
    """Command line."""
    default = QuantizeSettings()
    parser = argparse.ArgumentParser(prog="python -m export.quantize", description=__doc__)
    parser.add_argument("manifest", type=Path, help="manifest of an exported model; the int8 graphs are put beside it")
    parser.add_argument("--scene", type=Path, action="append", required=True, help="in MVSNet format; may be repeated")
    parser.add_argument("--views", type=int, default=4, help="views of each scene that calibrate")
    parser.add_argument("--compare-views", type=int, help="other views of each that compare; as many, 0 for none")
    parser.add_argument("--method", choices=sorted(METHODS), default=default.method)
    parser.add_argument("--operators", nargs="+", default=list(default.operators))
    parser.add_argument("--keep-float", nargs="*", default=list(default.keep_float), help="parts of weights' names")
    parser.add_argument("--weight-bits", type=int, choices=(7, 8), default=default.weight_bits)
    args = parser.parse_args(arguments)
    settings = QuantizeSettings(
        method=args.method,
        operators=tuple(args.operators),
        keep_float=tuple(args.keep_float),
        weight_bits=args.weight_bits,
    )
    logging.getLogger().setLevel(logging.ERROR)  # onnxruntime's tools warn of their own defaults
    cv2.setNumThreads(1)
    try:
        model = DepthModel.load(args.manifest, precision="float32")
        scenes = [read_scene(path) for path in args.scene]
        feeds = [
            found
            for scene in scenes
            for found in inputs_of_graphs(model, scene, choose_views(scene, args.views), settings.window_px)
        ]
        targets = {}
        for role in feeds[0]:
            graph = model.manifest.folder / model.manifest.details["graphs"][role]["file"]
            targets[role] = graph.with_name(f"{graph.stem}_int8.onnx")
            quantize(graph, targets[role].with_suffix(".new"), [found[role] for found in feeds], settings)
        # Without the entry first: the model can be read at any moment.
        drop_from_manifest(args.manifest)
        for target in targets.values():
            target.with_suffix(".new").replace(target)
        # Those that fsinfer made are all called "scene".
        names = [path.parent.name if path.name == "scene" else path.name for path in args.scene]
        add_to_manifest(args.manifest, targets, settings, names, len(feeds))
        for target in targets.values():
            print(f"{target.name}: {target.stat().st_size} bytes, calibrated on {len(feeds)} views")
        compared = args.views if args.compare_views is None else args.compare_views
        if compared == 0:
            return 0
        difference = compare(args.manifest, scenes, compared)
    except FsinferError as error:
        print(f"Error: {error}")
        return 2
    print(
        f"against float32 on {difference.views} other views: plane index median {difference.index_median:.3f} planes, "
        f"{100 * difference.index_beyond_1:.2f} % beyond one plane; depth with confidence > 0.5: median "
        f"{100 * difference.depth_median_rel:.3f} %, {100 * difference.depth_beyond_1pct:.2f} % beyond 1 %"
    )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
