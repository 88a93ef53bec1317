"""Does ``fsinfer check`` name the stems that were seen from one side only, and no others?

python -m tests.bench.check PLOT OUT --trials 10           curtains on the scene in OUT/scene
python -m tests.bench.check PLOT OUT --leave-out 6:0,10:225
                                                           a real run without the photos that see tree 6 from 0 degrees
                                                           (the positive x axis) and tree 10 from 225; OUT is made
python -m tests.bench.check PLOT OUT --keep 0.2-1          a real run of a walk that began late: without the first fifth
                                                           of the photos (0-0.6: that stopped early; 0-1: all photos)

PLOT is a scene of ``training.synthesize --kind plot``; its exact depth maps tell which photo sees which stem. A stem is
one-sided in truth when the photos that see it leave a fan of 180 degrees or more empty, and seen all round when they
leave less than 150. A curtain takes a stem out of the depth maps of the photos on one side of it, and its points out of
what they share.
"""

from __future__ import annotations

import argparse
import csv
import shutil
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fsinfer.check import CheckResult, check_capture
from fsinfer.check.coarse_depth import read_glance, take_glance
from fsinfer.check.coverage import widest_gap
from fsinfer.check.run import judge_survey
from fsinfer.check.settings import CoverageSettings
from fsinfer.check.survey import survey_scene
from fsinfer.cli.console import stage_progress
from fsinfer.depth.maps import DepthMaps
from fsinfer.io.pfm import read_pfm, write_pfm
from fsinfer.poses.sparse import SparseModel, read_sparse
from fsinfer.scale.scale import Scale
from fsinfer.scene import Scene, read_scene
from tests.bench.plot import plot_settings, similarity
from tests.bench.results import add_result_options, check_result_options, save_result

ONE_SIDED_DEG, ALL_ROUND_DEG = 180.0, 150.0
FAR_M = CoverageSettings.far_m
NAMED = ("one side", "beyond")
_NO_SCALE = Scale(m_per_unit=None, source="none", rel_std=None)


@dataclass(frozen=True, kw_only=True)
class Truth:
    """``azimuths_deg`` and ``seen`` are (trees, photos); ``seen`` by the exact depth maps."""

    ids: list[str]
    xy: NDArray[np.float64]
    radius_m: NDArray[np.float64]
    z_m: NDArray[np.float64]
    names: list[str]
    centers: NDArray[np.float64]
    azimuths_deg: NDArray[np.float64]
    seen: NDArray[np.bool_]

    def gaps(
        self, photos: NDArray[np.bool_], curtains: dict[int, float], within_m: float = np.inf
    ) -> NDArray[np.float64]:
        """Widest empty fan of each tree, given which photos there are, and the curtains (tree: direction).

        Photos farther than ``within_m`` from the tree do not count.
        """
        gaps = []
        for tree in range(len(self.ids)):
            near = np.linalg.norm(self.centers[:, :2] - self.xy[tree], axis=1) < within_m
            seen = self.seen[tree] & photos & near
            if tree in curtains:
                seen = seen & ~behind(self.azimuths_deg[tree], curtains[tree])
            gaps.append(widest_gap(self.azimuths_deg[tree][seen])[0])
        return np.array(gaps)


def behind(azimuths_deg: NDArray[np.float64], direction_deg: float) -> NDArray[np.bool_]:
    """Whether photos stand in the half-plane round ``direction_deg``."""
    return np.asarray(np.abs((azimuths_deg - direction_deg + 180) % 360 - 180) < 90)


def read_truth(plot: Path) -> Truth:
    """Trees, cameras, and who sees whom."""
    scene = read_scene(plot)
    with (plot / "truth.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    xy = np.array([[float(row["x_m"]), float(row["y_m"])] for row in rows])
    z = np.array([float(row["z_ground_m"]) for row in rows])
    radius = np.array([float(row["dbh_cm"]) / 200 for row in rows])
    centers = np.array([view.camera.center for view in scene.views])
    offsets = centers[None, :, :2] - xy[:, None]
    heights = np.arange(0.6, 2.4, 0.1)
    seen = np.zeros((len(rows), len(scene.views)), dtype=bool)
    for index, view in enumerate(scene.views):
        depth = read_pfm(plot / "depths" / f"{view.name}.pfm")
        axis = np.concatenate([np.repeat(xy, len(heights), axis=0), (z[:, None] + heights).reshape(-1, 1)], axis=1)
        local = axis @ view.camera.cam_from_world[:3, :3].T + view.camera.cam_from_world[:3, 3]
        pixels = local @ view.camera.intrinsic.T
        front = local[:, 2] > 0.3
        column = np.where(front, np.rint(pixels[:, 0] / np.where(front, local[:, 2], 1)), -1).astype(int)
        row = np.where(front, np.rint(pixels[:, 1] / np.where(front, local[:, 2], 1)), -1).astype(int)
        inside = front & (column >= 0) & (row >= 0) & (column < depth.shape[1]) & (row < depth.shape[0])
        found = depth[np.where(inside, row, 0), np.where(inside, column, 0)]
        r = np.repeat(radius, len(heights))
        hit = inside & (np.abs(found - local[:, 2] + r) < 0.12 + r / 2)
        seen[:, index] = hit.reshape(len(rows), -1).sum(axis=1) >= 4
    return Truth(
        ids=[row["tree_id"] for row in rows],
        xy=xy,
        radius_m=radius,
        z_m=z,
        names=[view.name for view in scene.views],
        centers=centers,
        azimuths_deg=np.degrees(np.arctan2(offsets[..., 1], offsets[..., 0])),
        seen=seen,
    )


@dataclass(frozen=True, kw_only=True)
class Curtains:
    """Directions from which trees are hidden, by their rank in truth; and how the scene lies in truth's frame."""

    directions: dict[int, float]
    truth: Truth
    scene: Scene
    motion: tuple[float, NDArray[np.float64], NDArray[np.float64]]

    def hides(self, tree: int, name: str) -> bool:
        """Whether the photo of this name stands behind the tree's curtain."""
        return bool(behind(self.truth.azimuths_deg[tree][[self.truth.names.index(name)]], self.directions[tree])[0])

    def on(self, tree: int, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which points (..., 3) of the scene lie on the tree, up to 5 m."""
        scale, rotation, shift = self.motion
        placed = scale * points @ rotation.T + shift
        away = np.linalg.norm(placed[..., :2] - self.truth.xy[tree], axis=-1)
        ground = self.truth.z_m[tree]
        low = (placed[..., 2] > ground) & (placed[..., 2] < ground + 5)
        return np.asarray(low & (away < self.truth.radius_m[tree] + 0.25))

    def over_points(self, sparse: SparseModel) -> SparseModel:
        """The sparse model without the observations that are hidden."""
        observations = {name: seen.copy() for name, seen in sparse.observations.items()}
        lost = np.zeros(len(sparse.points), dtype=np.int64)
        for tree in self.directions:
            on = self.on(tree, sparse.points)
            for view in self.scene.views:
                if self.hides(tree, view.name):
                    seen = observations[view.name]
                    lost[seen[on[seen]]] += 1
                    observations[view.name] = seen[~on[seen]]
        return replace(sparse, observations=observations, track_lengths=sparse.track_lengths - lost)

    def over_maps(self, maps: DepthMaps, folder: Path) -> None:
        """Write the depth maps without what is hidden into ``folder``; those where nothing is are linked."""
        shutil.rmtree(folder, ignore_errors=True)
        for part in ("depth", "confidence"):
            shutil.copytree(maps.folder / part, folder / part, copy_function=lambda a, b: Path(b).symlink_to(a))
        for index in maps.available:
            name = self.scene.views[index].name
            hidden = [tree for tree in self.directions if self.hides(tree, name)]
            if not hidden:
                continue
            found = maps.get(index)
            depth = np.divide(
                1, found.inverse_depth, out=np.zeros_like(found.inverse_depth), where=found.inverse_depth > 0
            )
            v, u = np.indices(depth.shape)
            rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(found.intrinsic).T
            points = (rays * depth[..., None] - found.cam_from_world[:3, 3]) @ found.cam_from_world[:3, :3]
            for tree in hidden:
                depth[self.on(tree, points)] = 0
            (folder / "depth" / f"{name}.pfm").unlink()
            write_pfm(folder / "depth" / f"{name}.pfm", depth)


#: What may come of a tree, in the order of :func:`compare`.
OUTCOMES = ("named rightly", "named, other side seen from far", "named wrongly", "not named", "without points")


def compare(
    result: CheckResult, truth: Truth, photos: NDArray[np.bool_], curtains: dict[int, float]
) -> tuple[list[str], ...]:
    """Trees by truth's id for each of ``OUTCOMES``; the second: its other side was seen only from beyond ``FAR_M``."""
    gaps, near_gaps = truth.gaps(photos, curtains), truth.gaps(photos, curtains, FAR_M)
    expected = np.array([truth.centers[truth.names.index(name)][:2] for name in result.names])
    plan, world = result.cameras @ [1, 1j], expected @ [1, 1j]
    factor = ((plan - plan.mean()).conj() * (world - world.mean())).sum() / (np.abs(plan - plan.mean()) ** 2).sum()
    right, far, wrong, found = [], [], [], {}
    for entry in result.stems:
        place = factor * (entry.stem.center @ [1, 1j] - plan.mean()) + world.mean()
        distance = np.hypot(truth.xy[:, 0] - place.real, truth.xy[:, 1] - place.imag)
        tree = int(distance.argmin())
        known = distance[tree] < truth.radius_m[tree] + 0.4
        if known:
            found[tree] = entry.verdict
        if entry.verdict in NAMED:
            if known and gaps[tree] >= ONE_SIDED_DEG:
                right.append(truth.ids[tree])
            elif known and gaps[tree] >= ALL_ROUND_DEG:
                continue
            elif known and near_gaps[tree] >= ALL_ROUND_DEG:
                far.append(truth.ids[tree])
            # Those that stand outside truth's plot are behind its edge.
            elif known or entry.verdict == "one side":
                wrong.append(truth.ids[tree] if known else "no tree")
    one_sided = [tree for tree in range(len(truth.ids)) if gaps[tree] >= ONE_SIDED_DEG]
    missed = [f"{truth.ids[tree]} ({found[tree]})" for tree in one_sided if found.get(tree, NAMED[0]) not in NAMED]
    without = [truth.ids[tree] for tree in one_sided if tree not in found]
    return right, far, wrong, missed, without


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.check", description=__doc__)
    parser.add_argument("plot", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--trials", type=int, default=10)
    parser.add_argument("--per-trial", type=int, default=3, help="stems behind a curtain in each trial")
    parser.add_argument("--min-dbh-cm", type=float, default=12.0, help="of the stems behind curtains")
    parser.add_argument(
        "--leave-out", metavar="TREE:DEG,...", help="leave out the photos that see these trees from this side"
    )
    parser.add_argument("--keep", metavar="FROM-TO", help="keep only this stretch of the walk, as shares of its photos")
    add_result_options(parser)
    args = parser.parse_args(argv)
    check_result_options(parser, args)
    truth = read_truth(args.plot)
    totals = np.zeros(len(OUTCOMES), dtype=int)
    if args.leave_out or args.keep:
        return check_photos(args, truth, argv)
    scene = read_scene(args.out / "scene")
    sparse = read_sparse(args.out / "scene" / "sparse")
    photos = np.isin(truth.names, [view.name for view in scene.views])
    given = [view.name for view in scene.views]
    centers = np.array([view.camera.center for view in scene.views])
    expected = np.array([truth.centers[truth.names.index(view.name)] for view in scene.views])
    motion = similarity(centers, expected)
    look = take_glance(scene, args.out / "check" / "bench")
    assert look is not None
    rng = np.random.default_rng(0)
    thick = np.flatnonzero(truth.radius_m >= args.min_dbh_cm / 200)
    for trial in range(args.trials + 1):
        chosen = rng.choice(thick, args.per_trial, replace=False) if trial else []
        directions = {int(tree): float(rng.uniform(0, 360)) for tree in chosen}
        curtains = Curtains(directions=directions, truth=truth, scene=scene, motion=motion)
        curtains.over_maps(look.maps, args.out / "check" / "curtains")
        glance = read_glance(scene, args.out / "check" / "curtains")
        survey = survey_scene(scene, curtains.over_points(sparse), glance, m_per_unit=motion[0])
        result = judge_survey(survey, given, _NO_SCALE, _NO_SCALE)
        outcome = compare(result, truth, photos, directions)
        totals += [len(part) for part in outcome]
        behind_curtains = ", ".join(truth.ids[tree] for tree in directions) or "-"
        told = "; ".join(f"{label} {', '.join(part) or '-'}" for label, part in zip(OUTCOMES, outcome, strict=True))
        print(f"trial {trial}: behind curtains {behind_curtains}; {told}", flush=True)
    print(", ".join(f"{label} {total}" for label, total in zip(OUTCOMES, totals, strict=True)))
    figures = {figure_name(label): int(total) for label, total in zip(OUTCOMES, totals, strict=True)}
    settings = plot_settings(args.plot)
    save_result(args, figures, module="tests.bench.check", arguments=argv, settings=settings)
    return 0


def figure_name(label: str) -> str:
    """One of ``OUTCOMES`` as the name of a count of stems."""
    return "stems_" + label.replace(",", "").replace(" ", "_")


def check_photos(args: argparse.Namespace, truth: Truth, argv: list[str] | None) -> int:
    """The check itself on the photos that are left."""
    rank = np.arange(len(truth.names))
    first, last = (round(float(share) * len(rank)) for share in (args.keep or "0-1").split("-"))
    gone = (rank < first) | (rank >= last)
    for part in filter(None, (args.leave_out or "").split(",")):
        number, side_deg = part.split(":")
        tree = truth.ids.index(number)
        gone |= truth.seen[tree] & behind(truth.azimuths_deg[tree], float(side_deg))
    folder = args.out / "photos"
    folder.mkdir(parents=True, exist_ok=True)
    for name, out in zip(truth.names, gone, strict=True):
        if not out:
            shutil.copy(args.plot / "images" / f"{name}.jpg", folder)
    print(f"{int(gone.sum())} of {len(gone)} photos left out", flush=True)
    start = time.monotonic()
    with stage_progress(quiet=False) as progress:
        result = check_capture(folder, args.out, progress=progress)
    seconds = time.monotonic() - start
    print(f"{seconds:.0f} s", result.seconds, *result.notes, *result.lines, sep="\n  ")
    placed = np.isin(truth.names, result.names)
    figures: dict[str, float] = {
        "photos": int((~gone).sum()),
        "photos_registered": int(placed.sum()),
        "seconds": seconds,
    }
    for label, part in zip(OUTCOMES, compare(result, truth, placed, {}), strict=True):
        print(f"{label}: {', '.join(part) or '-'}")
        figures[figure_name(label)] = len(part)
    for label, within_m in (("true fans", np.inf), (f"within {FAR_M:g} m", FAR_M)):
        gaps = truth.gaps(placed, {}, within_m)
        print(f"{label}:", ", ".join(f"{number} {gap:.0f}" for number, gap in zip(truth.ids, gaps, strict=True)))
    settings = plot_settings(args.plot)
    save_result(args, figures, module="tests.bench.check", arguments=argv, settings=settings)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
