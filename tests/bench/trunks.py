"""DBH of single real trunks from stereo pairs with a trunk mask: ``python -m tests.bench.trunks TRUNKS OUT``.

TRUNKS holds MVSNet scenes (``T01`` …), each with ``mask.png`` of the trunk in view 0, and ``dbh.csv`` (scene, dbh_cm).
For every pair: the depth map of view 0 through ``fsinfer depth``, then, in five sections of the trunk, a circle
through the points of the visible arc and tangent to the two rays that touch the trunk's sides; their median counts.
The mask says where the trunk is, the photograph where it ends: the sides are the strongest edges near the mask's
border.
Beside it stands the median difference between the depth map and points triangulated from SIFT matches in the mask.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import least_squares

from fsinfer.depth.maps import DepthMaps
from fsinfer.depth.settings import DepthSettings
from fsinfer.depth.stage import estimate_depth
from fsinfer.geometry.triangulation import triangulate
from fsinfer.io.images import read_image
from fsinfer.scene import Scene, read_scene
from tests.bench.results import add_result_options, check_result_options, save_result

BANDS = ((0.30, 0.38), (0.38, 0.46), (0.46, 0.54), (0.54, 0.62), (0.62, 0.70))  # shares of the mask's height
EDGE_SHARE = 0.08  # of the trunk's width at each side that is left out: fattened edges, grazing surface
MATCH_RATIO = 0.75  # Lowe's ratio test, both ways
MATCH_ERROR_PX = 1.0
POINT_SIGMA_M = 0.01
EDGE_SIGMA_M = 0.002
SEARCH_PX = 5.0  # how far from the mask's border the photograph's edge may be
EDGE_BLUR_PX = 1.0


def band_rows(mask: NDArray[np.bool_], band: tuple[float, float]) -> list[tuple[int, NDArray[np.intp]]]:
    """Rows of the band, each with the mask's columns."""
    rows = np.flatnonzero(mask.any(axis=1))
    first, last = (int(rows[0] + share * (rows[-1] - rows[0])) for share in band)
    found = [(v, np.flatnonzero(mask[v])) for v in range(first, last + 1)]
    # Where the mask reaches a side of the picture that silhouette is not real.
    return [(v, c) for v, c in found if len(c) >= 8 and c[0] > 0 and c[-1] < mask.shape[1] - 1]


def silhouette_rays(
    image: NDArray[np.uint8], intrinsic: NDArray[np.float64], mask: NDArray[np.bool_], band: tuple[float, float]
) -> list[NDArray[np.float64]]:
    """Directions (M, 2) in x, z of the rays along the left and the right edge of the trunk in the photograph.

    Colours are averaged along the mask's border; the strongest change across it within ``SEARCH_PX`` is the edge.
    """
    inverse = np.linalg.inv(intrinsic)
    steps = np.arange(-SEARCH_PX - 4, SEARCH_PX + 4.01, 0.25)
    sides = []
    for end, outward in ((0, -1.0), (-1, 1.0)):
        border = np.array([(columns[end] + 0.5 * outward, v) for v, columns in band_rows(mask, band)])
        x = (border[:, :1] + outward * steps).astype(np.float32)
        y = np.broadcast_to(border[:, 1:], x.shape).astype(np.float32)
        strips = cv2.remap(image.astype(np.float32), x, np.ascontiguousarray(y), cv2.INTER_LINEAR)
        change = gaussian_filter1d(strips.mean(axis=0), EDGE_BLUR_PX / 0.25, axis=0, order=1)
        strength = np.where(np.abs(steps) <= SEARCH_PX, np.linalg.norm(change, axis=1), 0.0)
        edge = border + np.array([outward * steps[strength.argmax()], 0.0])
        sides.append((np.column_stack([edge, np.ones(len(edge))]) @ inverse.T)[:, [0, 2]])
    return sides


def trunk_points(
    depth: NDArray[np.float32], intrinsic: NDArray[np.float64], mask: NDArray[np.bool_], band: tuple[float, float]
) -> NDArray[np.float64]:
    """Points (N, 3) of the band, metres in the camera's frame."""
    points = []
    inverse = np.linalg.inv(intrinsic)
    for v, columns in band_rows(mask, band):
        margin = EDGE_SHARE * (columns[-1] - columns[0])
        inner = columns[(columns > columns[0] + margin) & (columns < columns[-1] - margin)]
        pixels = np.stack([inner, np.full(len(inner), v), np.ones(len(inner))])
        points.append((inverse @ pixels).T * depth[v, inner, None])
    return np.concatenate(points)


def fit_arc(
    points: NDArray[np.float64], left: NDArray[np.float64], right: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float]:
    """Centre (x, z) and radius of the circle through the points and tangent to both silhouettes, metres.

    The camera stands at the origin; a ray touches the circle where its distance from the centre is the radius.
    """
    xz = points[:, [0, 2]]
    near = float(np.median(xz[:, 1]))
    xz = xz[np.abs(xz[:, 1] - near) < 0.1 * near]  # what the mask cuts out of the background by mistake
    directions = [side.mean(axis=0) / np.linalg.norm(side.mean(axis=0)) for side in (left, right)]
    radius = near * float(np.arccos(np.clip(directions[0] @ directions[1], -1, 1))) / 2
    weight = 1 / np.sqrt(len(xz))  # the arc is one observation: its pixels err together

    def residuals(parameters: NDArray[np.float64]) -> NDArray[np.float64]:
        centre, r = parameters[:2], parameters[2]
        arc = (np.linalg.norm(xz - centre, axis=1) - r) * weight / POINT_SIGMA_M
        edges = [(abs(centre[0] * d[1] - centre[1] * d[0]) - r) / EDGE_SIGMA_M for d in directions]
        return np.concatenate([arc, edges])

    start = np.array([float(np.median(xz[:, 0])), near + radius, radius])
    # Twice the start's radius about it holds every trunk; without a wall a flat arc runs off to a giant circle.
    reach = np.array([radius, 2 * radius, 0.9 * radius])
    solution = least_squares(residuals, start, loss="soft_l1", x_scale=0.01, bounds=(start - reach, start + reach))
    return solution.x[:2], float(solution.x[2])


def matched_points(scene: Scene, mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(N, 3): pixel (u, v) of view 0 inside ``mask`` and z depth, of SIFT matches that two rays agree on."""
    sift = cv2.SIFT.create(contrastThreshold=0.01)
    found = [
        sift.detectAndCompute(cv2.cvtColor(read_image(view.image_path), cv2.COLOR_RGB2GRAY), region)
        for view, region in zip(scene.views[:2], (mask.astype(np.uint8), None), strict=True)
    ]
    (keys0, first), (keys1, second) = found
    matcher = cv2.BFMatcher()
    ways = []
    for a, b in ((first, second), (second, first)):
        pairs = matcher.knnMatch(a, b, k=2)
        ways.append({m.queryIdx: m.trainIdx for m, n in pairs if m.distance < MATCH_RATIO * n.distance})
    projections = [view.camera.intrinsic @ view.camera.cam_from_world[:3] for view in scene.views[:2]]
    rows = []
    for i, j in ways[0].items():
        if ways[1].get(j) != i:
            continue
        point = triangulate(projections, np.array([keys0[i].pt, keys1[j].pt]))
        if point is not None and point.max_error_px < MATCH_ERROR_PX:
            z = float((scene.views[0].camera.cam_from_world[:3] @ [*point.xyz, 1.0])[2])
            rows.append((*keys0[i].pt, z))
    return np.array(rows).reshape(-1, 3)


def main(argv: list[str] | None = None) -> int:
    """Run all pairs and print the table with the mean absolute error."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.trunks", description=__doc__)
    parser.add_argument("trunks", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--model", default=DepthSettings.model)
    add_result_options(parser)
    args = parser.parse_args(argv)
    check_result_options(parser, args)
    with (args.trunks / "dbh.csv").open(encoding="utf-8") as file:
        truth = {row["scene"]: float(row["dbh_cm"]) for row in csv.DictReader(file)}
    errors, worst_match = [], 0.0
    for name, expected in truth.items():
        scene = read_scene(args.trunks / name)
        estimate_depth(scene, args.out / name, settings=DepthSettings(model=args.model))
        found = DepthMaps(scene, args.out / name).get(0)
        depth, grid = np.float32(1) / found.inverse_depth, found.grid
        mask = read_image(args.trunks / name / "mask.png").max(axis=-1) > 127
        v, u = (
            np.rint(np.arange(n) * s + o).astype(int)
            for n, s, o in zip(
                depth.shape, (grid.step_y, grid.step_x), (grid.offset_y_px, grid.offset_x_px), strict=True
            )
        )
        small = mask[np.ix_(np.clip(v, 0, mask.shape[0] - 1), np.clip(u, 0, mask.shape[1] - 1))]
        view = scene.views[0]
        photo = read_image(view.image_path)
        bands = []
        for band in BANDS:
            left, right = silhouette_rays(photo, view.camera.intrinsic, mask, band)
            bands.append(200 * fit_arc(trunk_points(depth, found.intrinsic, small, band), left, right)[1])
        dbh_cm = float(np.median(bands))
        errors.append(dbh_cm - expected)
        distance = float(np.median(depth[small]))
        points = matched_points(scene, mask)
        columns = np.rint((points[:, 0] - grid.offset_x_px) / grid.step_x).astype(int).clip(0, depth.shape[1] - 1)
        rows = np.rint((points[:, 1] - grid.offset_y_px) / grid.step_y).astype(int).clip(0, depth.shape[0] - 1)
        differences = np.abs(depth[rows, columns] / points[:, 2] - 1)
        worst_match = max(worst_match, float(np.median(differences)))
        print(
            f"{name}: {dbh_cm:6.2f} cm (sections {min(bands):.1f} to {max(bands):.1f}), tape {expected:6.2f} cm, "
            f"error {errors[-1]:+5.2f} cm, {distance:.2f} m; depth to {len(points)} matched points: median "
            f"{100 * np.median(differences):.2f} %"
        )
    absolute = np.abs(errors)
    print(
        f"{len(errors)} pairs: MAE {absolute.mean():.2f} cm, bias {np.mean(errors):+.2f} cm, "
        f"worst {absolute.max():.2f}; "
        f"depth to matched points: at most {100 * worst_match:.2f} %"
    )
    figures = {
        "trunks": len(errors),
        "mae_cm": float(absolute.mean()),
        "bias_cm": float(np.mean(errors)),
        "worst_cm": float(absolute.max()),
        "depth_vs_matches_worst_percent": 100 * worst_match,
    }
    save_result(args, figures, module="tests.bench.trunks", arguments=argv)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
