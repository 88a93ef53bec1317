"""Ours beside SfM-MVS on the same photographs: ``python -m tests.bench.sfm_mvs PLOT OUT --cloud NAME=FILE``.

PLOT is what ``training.synthesize --kind plot`` writes, OUT what ``fsinfer run`` made of its photographs. Each FILE is
a dense cloud that another program made of the cameras in OUT/scene (``sparse`` there is COLMAP's own format), in the
coordinates of that scene, and so is OUT/fused/cloud.ply, our own. Every cloud is scaled and levelled alike, by
``plot.json``, and goes through the same tree stage, points alone; the edges in the photographs have no part in any row.

COLMAP: ``colmap image_undistorter --image_path OUT/scene/images --input_path OUT/scene/sparse --output_path DENSE``,
``colmap patch_match_stereo --workspace_path DENSE``, ``colmap stereo_fusion --workspace_path DENSE --output_path
FILE``.
OpenMVS: ``InterfaceCOLMAP -i DENSE -o scene.mvs``, ``DensifyPointCloud scene.mvs``.
Without either: ``python -m tests.bench.sgm OUT/scene SGM``, ``fsinfer fuse OUT/scene SGM --no-level``, SGM/cloud.ply.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import FsinferError
from fsinfer.io.cloud import read_cloud
from fsinfer.placement.place import density_per_m2
from fsinfer.trees import analyse_plot
from tests.bench.plot import align_cameras, plot_settings, tree_figures
from tests.bench.results import add_result_options, check_result_options, save_result


def named_cloud(text: str) -> tuple[str, Path]:
    """NAME=FILE."""
    name, found, path = text.partition("=")
    if not (found and name.isidentifier() and name.islower()):
        msg = f"{text!r}: give a name in small letters and a file, such as openmvs=dense.ply"
        raise argparse.ArgumentTypeError(msg)
    return name, Path(path)


def row_of(plot: Path, out: Path, path: Path, cloud_from_scene: NDArray[np.float64]) -> dict[str, float | None]:
    """Figures of the trees in one cloud."""
    points = read_cloud(path).xyz @ cloud_from_scene[:3, :3].T + cloud_from_scene[:3, 3]
    figures: dict[str, float | None] = {"points": len(points), "density_per_m2": density_per_m2(points)}
    try:
        found = analyse_plot(points, turned=True)
    except FsinferError as error:
        print(f"{path}: {error}")
        return figures
    trees, result = align_cameras(plot, out, cloud_from_scene).evaluate(plot, found.trees)
    by_id = {str(tree.tree_id): tree for tree in trees}
    inside = []
    for pair in result.pairs:
        if pair.extracted_cm is not None:
            tree = by_id[pair.extracted_id]
            inside.append((tree.dbh_lo95_cm or 0.0) <= pair.measured_cm <= (tree.dbh_hi95_cm or 0.0))
    return figures | tree_figures(result, inside)


def main(argv: list[str] | None = None) -> int:
    """Judge every cloud, print a row for each."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.bench.sfm_mvs", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("plot", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--cloud", type=named_cloud, action="append", default=[], metavar="NAME=FILE")
    add_result_options(parser)
    args = parser.parse_args(argv)
    check_result_options(parser, args)
    cloud_from_scene = np.array(json.loads((args.out / "plot.json").read_text(encoding="utf-8"))["cloud_from_scene"])
    figures: dict[str, float | None] = {}
    for name, path in [("fsinfer", args.out / "fused" / "cloud.ply"), *args.cloud]:
        row = row_of(args.plot, args.out, path, cloud_from_scene)
        print(name)
        for key, value in row.items():
            print(f"  {key:24s} {'none' if value is None else f'{value:.4g}'}", flush=True)
        figures |= {f"{name}_{key}": value for key, value in row.items()}
    save_result(
        args, figures, module="tests.bench.sfm_mvs", arguments=argv, settings={"plot": plot_settings(args.plot)}
    )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
