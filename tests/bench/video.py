"""A rendered phone video through frames, poses and scale, with no option but the output folder.

python -m tests.bench.video OUT [--places 150] [--full]

The video is what a forester brings home after a minute and a half: two loops at half a metre a second, portrait (stored
on its side, with the rotation flag in the file), blur by motion, changing exposure, boards as ``fsinfer marker`` prints
them (numbers 40 to 42 are 0.25 m), one of them turned by 45 degrees. A phone's shake is a rotation, so one rendered
picture every 0.3 m gives every frame of that place exactly, by a homography; blur is the mean of rotated sub-frames.
Printed: the frames chosen, the errors of the cameras and the scale, and the scale budget. ``--full`` goes on to depth,
trees and the report, and compares the diameters with the truth.
"""

from __future__ import annotations

import argparse
import json
import struct
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fsinfer.depth.settings import DepthSettings
from fsinfer.evaluation.measured import read_measured
from fsinfer.evaluation.metrics import evaluate
from fsinfer.frames.select import select_frames
from fsinfer.io.images import read_image
from fsinfer.notices.sentences import sentences
from fsinfer.poses.estimate import estimate_poses
from fsinfer.poses.settings import PoseSettings
from fsinfer.scale.find import find_scale
from fsinfer.scale.request import ScaleRequest
from fsinfer.scene import Camera, Scene, read_camera, read_scene, write_camera
from fsinfer.trees.outputs.table import read_trees
from fsinfer.workflow.pipeline import run
from fsinfer.workflow.settings import RunSettings
from tests.bench.plot import run_figures, similarity, tree_figures
from tests.bench.results import add_result_options, check_result_options, save_result
from training.synthesize.cameras.camera_path import intrinsics, look_at, make_camera
from training.synthesize.cameras.photo import expose, random_sensor
from training.synthesize.cameras.plot import CLEARANCE_M
from training.synthesize.forest.boards import board_material, board_pair
from training.synthesize.forest.mesh import merge
from training.synthesize.forest.terrain import Terrain
from training.synthesize.forest.world import WorldSettings, build_world
from training.synthesize.render import Caster

WIDTH, HEIGHT, HFOV_DEG = 720, 1280, 40.0
#: Frames a second of the video, and how many of them one place gives: 0.3 m at half a metre a second.
RATE, FRAMES_A_PLACE = 10, 6
BOARDS = (40, 41, 42)
#: Their distance from the middle of the plot; they face outward, to the outer loop 1.8 m away.
BOARD_RADIUS_M = 3.2
TURNED_DEG = 45.0


def clear_bearing(obstacles: NDArray[np.float64], nominal_rad: float, walk_m: float) -> float:
    """The bearing near ``nominal_rad`` from which a board sees most of the outer loop, free of stems."""
    bearings = nominal_rad + np.radians(np.arange(-50, 51, 2))
    clear_m = []
    for bearing in bearings:
        board = BOARD_RADIUS_M * np.array([np.cos(bearing), np.sin(bearing)])
        ends = walk_m * np.array([[np.cos(bearing + a), np.sin(bearing + a)] for a in np.radians([-20, 0, 20])])
        lines = (board + np.linspace(0, 1, 12)[:, None, None] * (ends - board)).reshape(-1, 2)
        away = np.linalg.norm(lines[:, None] - obstacles[None, :, :2], axis=2) - obstacles[:, 2]
        clear_m.append(min(float(away.min()), 0.5) - 0.001 * abs(bearing - nominal_rad))
    return float(bearings[int(np.argmax(clear_m))])


def path_of_cameras(
    rng: np.random.Generator, terrain: Terrain, obstacles: NDArray[np.float64], outer_m: float, places: int
) -> list[Camera]:
    """Two loops looking in, swaying a little to both sides, round whatever stands in the way, in even steps."""
    bearing = np.linspace(0, 4.25 * np.pi, 4000)
    inward = np.clip((bearing - 1.75 * np.pi) / (0.5 * np.pi), 0, 1)
    radius = outer_m * (1 - 0.55 * inward**2 * (3 - 2 * inward))
    line = np.stack([radius * np.cos(bearing), radius * np.sin(bearing)], axis=-1)
    for _ in range(300):
        for x, y, size in obstacles:
            away = line - [x, y]
            distance = np.linalg.norm(away, axis=1)
            line += away / distance[:, None] * np.clip(size + CLEARANCE_M - distance, 0, None)[:, None]
        for _ in range(20):
            line[1:-1] = 0.5 * line[1:-1] + 0.25 * (line[:-2] + line[2:])
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    at = np.linspace(0, length[-1], places)
    walked = np.stack([np.interp(at, length, line[:, axis]) for axis in range(2)], axis=-1)
    yaw = np.interp(at, length, bearing) + np.pi + 0.2 * np.sin(2 * np.pi * at / 10)
    intrinsic = intrinsics(WIDTH, HEIGHT, HFOV_DEG)
    cameras = []
    for (x, y), heading in zip(walked, yaw, strict=True):
        ground = float(terrain.height(x, y))
        center = np.array([x, y, ground + 1.5 + rng.normal(0, 0.03)])
        ahead = 4 * np.array([np.cos(heading), np.sin(heading)])
        drop = 4 * np.tan(np.radians(rng.normal(8, 1.5)))
        slope = float(terrain.height(x + ahead[0], y + ahead[1])) - ground
        target = center + np.array([*ahead, 0.7 * slope - drop])
        cameras.append(make_camera(intrinsic, look_at(center, target, rng.normal(0, 0.03))))
    return cameras


def render(out: Path, *, places: int, seed: int) -> None:
    """One sharp picture for each place, with its true camera, and ``truth.csv``; pictures that are there are kept."""
    from training.synthesize.scene_writer import write_truth

    settings = WorldSettings(
        radius_m=3.5,
        outer_m=22.0,
        trees=6,
        outer_trees=18,
        slope_deg=4.0,
        roughness=0.5,
        undergrowth=0.15,
        season="winter",
        clutter=False,
        detail_radius_m=6.0,
        ground_step_m=0.06,
        outer_gap_m=2.3,
        min_dbh_m=0.12,
    )
    world = build_world(np.random.default_rng([seed, 1]), settings)
    solid, posts = [world.opaque], []
    for number, board in enumerate(BOARDS):
        facing = clear_bearing(world.obstacles, 2 * np.pi * number / len(BOARDS), settings.radius_m + 1.5)
        place = BOARD_RADIUS_M * np.array([np.cos(facing), np.sin(facing)])
        posts.append([*place, 0.1])
        material = len(world.materials)
        world.materials.append(board_material(board))
        front, _ = board_pair(world.terrain, place, facing, (board, 0), (material, material), 1)
        sheet, post, plate = front.meshes
        if number == 0:
            center = sheet.vertices.mean(axis=0)
            axis = np.array([np.cos(facing), np.sin(facing), 0.0])
            turn = Rotation.from_rotvec(np.radians(TURNED_DEG) * axis).as_matrix()
            sheet, plate = (
                replace(m, vertices=((m.vertices - center) @ turn.T + center).astype(m.vertices.dtype))
                for m in (sheet, plate)
            )
        solid += [sheet, post, plate]
    caster = Caster(merge(solid), world.cards, world.materials, world.light)
    rng = np.random.default_rng([seed, 2])
    obstacles = np.concatenate([world.obstacles, posts])
    cameras = path_of_cameras(rng, world.terrain, obstacles, settings.radius_m + 1.5, places)
    write_truth(out / "truth.csv", world.stems[: world.in_plot], world.sections[: world.in_plot])
    sensor = random_sensor(rng, caster.picture(cameras[0], WIDTH // 2, HEIGHT // 2, 1))
    start = time.perf_counter()
    for index, camera in enumerate(cameras):
        path = out / "places" / f"{index:03d}.png"
        write_camera(out / "places" / f"{index:03d}_cam.txt", camera)
        if not path.is_file():
            picture = expose(np.random.default_rng([seed, 3, index]), sensor, caster.picture(camera, WIDTH, HEIGHT, 2))
            cv2.imwrite(str(path), picture[:, :, ::-1])
        print(f"place {index + 1}/{places}, {time.perf_counter() - start:.0f} s", flush=True)


def shaken(image: NDArray[np.uint8], intrinsic: NDArray[np.float64], path: NDArray[np.float64]) -> NDArray[np.float64]:
    """The mean of the picture as seen by cameras turned by the rotation vectors ``path`` (n, 3), radians."""
    total = np.zeros(image.shape)
    for vector in path:
        turn = intrinsic @ Rotation.from_rotvec(vector).as_matrix() @ np.linalg.inv(intrinsic)
        total += cv2.warpPerspective(
            image, turn, (image.shape[1], image.shape[0]), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT
        )
    return total / len(path)


def make_video(out: Path, *, places: int, seed: int) -> Path:
    """``video.mp4``: stored lying on its side, with the flag that turns it upright."""
    path = out / "video.mp4"
    rng = np.random.default_rng([seed, 4])
    part = out / "part.mp4"
    writer = cv2.VideoWriter(str(part), cv2.VideoWriter.fourcc(*"mp4v"), RATE, (HEIGHT, WIDTH))
    for index in range(places):
        image = np.ascontiguousarray(read_image(out / "places" / f"{index:03d}.png")[..., ::-1])
        intrinsic = read_camera(out / "places" / f"{index:03d}_cam.txt").intrinsic
        # Clouds move: the exposure swings by two thirds of a stop each way during the walk.
        gain = 2 ** (0.67 * np.sin(2 * np.pi * index / places * 2.5) / 2.2)
        # Every eleventh place is passed in a hurry: nothing there is sharp.
        hurried = index % 11 == 4
        for _ in range(FRAMES_A_PLACE):
            sharp = rng.random() < 0.3 and not hurried
            length = np.radians(0.03 if sharp else rng.uniform(0.3, 1.0) * (1.5 if hurried else 1))
            direction = rng.normal(size=3) * (1, 1, 0.3)
            direction *= length / np.linalg.norm(direction)
            offset = np.radians(rng.normal(0, 0.15, 3))
            steps = np.linspace(-0.5, 0.5, 2 if sharp else 9)[:, None]
            frame = np.clip(shaken(image, intrinsic, offset + steps * direction) * gain, 0, 255).astype(np.uint8)
            writer.write(np.ascontiguousarray(np.rot90(frame, 1)))
    writer.release()
    set_rotation_flag(part)
    part.replace(path)
    return path


def set_rotation_flag(path: Path) -> None:
    """Write "turn a quarter clockwise to show" into the track header of an MP4 (ISO 14496-12, 8.3.2)."""
    data = bytearray(path.read_bytes())
    at = data.rindex(b"tkhd") + 4 + 40
    one = 1 << 16
    data[at : at + 36] = struct.pack(">9i", 0, one, 0, -one, 0, 0, WIDTH * one, 0, 1 << 30)
    path.write_bytes(bytes(data))


def true_centers(out: Path, scene: Scene) -> NDArray[np.float64]:
    """(N, 3) true places of the cameras; the name of a frame ends in its number in the video."""
    places = [int(view.name.rsplit("_", 1)[1]) // FRAMES_A_PLACE for view in scene.views]
    return np.array([read_camera(out / "places" / f"{place:03d}_cam.txt").center for place in places])


def compare_trees(out: Path, plot: dict[str, Any], scene: Scene) -> dict[str, float | None]:
    """The diameters against ``truth.csv``, positions aligned by the cameras; printed, and as figures."""
    cloud_from_scene = np.array(plot["cloud_from_scene"])
    centers = np.array([view.camera.center for view in scene.views])
    centers = centers @ cloud_from_scene[:3, :3].T + cloud_from_scene[:3, 3]
    scale, rotation, shift = similarity(centers, true_centers(out, scene))
    trees = []
    for tree in read_trees(out / "result" / "trees.csv"):
        x, y, _ = scale * rotation @ np.array([tree.x_m, tree.y_m, tree.z_ground_m]) + shift
        trees.append(replace(tree, x_m=float(x), y_m=float(y)))
    result = evaluate(read_measured(out / "truth.csv"), trees, align="never", area_margin_m=1.0)
    by_id = {str(tree.tree_id): tree for tree in trees}
    inside = []
    for pair in result.pairs:
        tree = by_id[pair.extracted_id]
        if tree.dbh_lo95_cm is not None and tree.dbh_hi95_cm is not None:
            inside.append(tree.dbh_lo95_cm <= pair.measured_cm <= tree.dbh_hi95_cm)
        print(
            f"tree {pair.measured_id}: {pair.measured_cm:.2f} cm, found {pair.extracted_cm} "
            f"[{tree.dbh_lo95_cm}, {tree.dbh_hi95_cm}] {tree.status} {tree.reason}"
        )
    print(
        f"n {result.n}, matched {result.matched}, omitted {result.omitted}, false {result.false}, "
        f"outside {result.outside}, RMSE {result.rmse_cm} cm, bias {result.bias_cm} cm"
    )
    return tree_figures(result, inside)


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.video", description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--places", type=int, default=150, help="rendered along the walk")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--full", action="store_true", help="the whole pipeline, up to the report")
    parser.add_argument("--render-only", action="store_true")
    parser.add_argument("--max-features", type=int, default=PoseSettings().max_features, help="fewer are faster")
    parser.add_argument("--max-size", type=int, default=DepthSettings().max_size_px, help="of fsinfer run")
    add_result_options(parser)
    args = parser.parse_args(argv)
    check_result_options(parser, args)
    cv2.setNumThreads(1)
    args.out.mkdir(parents=True, exist_ok=True)
    if not (args.out / "video.mp4").is_file():
        render(args.out, places=args.places, seed=args.seed)
        make_video(args.out, places=args.places, seed=args.seed)
    if args.render_only:
        return 0
    result = args.out / "result"
    if args.full:
        poses = PoseSettings(max_features=args.max_features)
        settings = RunSettings(poses=poses, depth=DepthSettings(max_size_px=args.max_size))
        run(args.out / "video.mp4", result, settings=settings)
    else:
        chosen = select_frames(args.out / "video.mp4", result / "frames")
        print(f"frames: {len(chosen.images)} of {len(chosen.rows)}", *sentences(chosen.warnings), sep="\n  ")
        start = time.perf_counter()
        fewer = PoseSettings(max_features=args.max_features)
        placed = estimate_poses(result / "frames" / "images", result / "scene", settings=fewer)
        print(
            f"poses: {placed.registered} of {placed.photos}, {time.perf_counter() - start:.0f} s",
            *sentences(placed.warnings),
        )
    scene = read_scene(result / "scene")
    found = find_scale(ScaleRequest(), scene=scene)
    scale = found.scale
    print(*sentences(found.warnings), sep="\n")
    centers, expected = np.array([view.camera.center for view in scene.views]), true_centers(args.out, scene)
    true_scale, rotation, shift = similarity(centers, expected)
    residual_m = np.linalg.norm(true_scale * centers @ rotation.T + shift - expected, axis=1)
    print(f"cameras rms {1000 * np.sqrt((residual_m**2).mean()):.1f} mm")
    figures: dict[str, float | None] = {
        "frames_registered": len(scene.views),
        "cameras_rms_mm": 1000 * float(np.sqrt((residual_m**2).mean())),
    }
    if scale.m_per_unit is None or scale.rel_std is None:
        return 1
    figures |= {
        "boards": len(scale.markers),
        "scale_error_percent": 100 * (scale.m_per_unit / true_scale - 1),
        "scale_std_percent": 100 * scale.rel_std,
    }
    print(f"scale error {100 * (scale.m_per_unit / true_scale - 1):+.3f} % (given +- {100 * scale.rel_std:.3f} %)")
    for marker in scale.markers:
        print(
            f"  board {marker.id}: {len(marker.views)} views, residual {marker.residual_mm:+.2f} mm, "
            f"error {marker.error_px:.2f} px, without it {100 * (marker.leave_one_out_rel or 0):+.3f} %"
        )
    if args.full:
        plot = json.loads((result / "plot.json").read_text(encoding="utf-8"))
        figures |= run_figures(plot) | compare_trees(args.out, plot, scene)
        print("photos", plot["photos"], "registered", plot["registered"], "seconds", plot["seconds"])
    drawn = {"seed": args.seed, "places": args.places}
    save_result(args, figures, module="tests.bench.video", arguments=argv, settings=drawn)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
