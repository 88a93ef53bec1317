"""An output folder with all that a report shows: the three exact stems of ``synthetic_plot`` in their photographs."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np

from fsinfer.io.cloud import PointCloud, write_cloud
from fsinfer.io.images import write_image
from fsinfer.scene import read_scene
from tests.support.synthetic_plot import (
    _TURN,
    HEIGHT_M,
    M_PER_UNIT,
    STEMS,
    VIEWS,
    write_depth_folder,
    write_scene_folder,
)

CLOUD_FROM_SCENE = np.eye(4)
CLOUD_FROM_SCENE[:3, :3] = M_PER_UNIT * _TURN.T
STATUS = ("ok", "doubtful", "ok")


def plot_cloud(points_per_stem: int = 3000, ground: int = 20_000) -> PointCloud:
    """Stems and ground in metres with colours, confidence and TreeID."""
    rng = np.random.default_rng(0)
    pieces, labels = (
        [np.column_stack([rng.uniform(-4, 4, (ground, 2)), rng.normal(0, 0.01, ground)])],
        [np.zeros(ground)],
    )
    for number, (x_m, y_m, radius_m) in enumerate(STEMS, start=1):
        angle, z = rng.uniform(0, 2 * np.pi, points_per_stem), rng.uniform(0, HEIGHT_M, points_per_stem)
        pieces.append(np.column_stack([x_m + radius_m * np.cos(angle), y_m + radius_m * np.sin(angle), z]))
        labels.append(np.full(points_per_stem, number))
    xyz, tree_id = np.concatenate(pieces), np.concatenate(labels).astype(np.int32)
    rgb = np.where(tree_id[:, None] > 0, [120, 90, 60], [70, 110, 50]).astype(np.uint8)
    confidence = rng.uniform(0.3, 1, len(xyz)).astype(np.float32)
    return PointCloud(xyz=xyz, rgb=rgb, extra={"confidence": confidence, "TreeID": tree_id})


def tree_rows() -> list[dict[str, Any]]:
    """``trees.csv`` of the three stems."""
    rows = []
    for number, ((x_m, y_m, radius_m), status) in enumerate(zip(STEMS, STATUS, strict=True), start=1):
        dbh_cm = 200 * radius_m
        rows.append(
            {
                "tree_id": number, "x_m": x_m, "y_m": y_m, "z_ground_m": 0.0, "dbh_cm": dbh_cm,
                "dbh_lo95_cm": dbh_cm - 1, "dbh_hi95_cm": dbh_cm + 1, "dbh_perimeter_cm": "", "dbh_min_cm": "",
                "dbh_max_cm": "", "bh_m": 1.3, "arc_coverage": 1.0, "points": 500, "residual_cm": 0.3, "lean_deg": 0.5,
                "height_m": "", "status": status, "reason": "",
            }
        )  # fmt: skip
    return rows


def write_report_folder(out: Path) -> Path:
    """Write the folder; the photographs are grey noise, the depth maps exact."""
    write_scene_folder(out / "scene")
    write_depth_folder(read_scene(out / "scene"), out)
    write_cloud(out / "trees.laz", plot_cloud())
    rows = tree_rows()
    with (out / "trees.csv").open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    plot = {
        "source": "synthetic", "photos": VIEWS, "registered": VIEWS, "units": "m", "scale_m_per_unit": M_PER_UNIT,
        "scale_source": "factor", "cloud_from_scene": CLOUD_FROM_SCENE.tolist(), "camera_height": 1.5, "points": 29_000,
        "density_per_m2": 450.0, "plot_area_m2": 64.0, "seconds": {"total": 60.0}, "versions": {"fsinfer": "0"},
        "model": "exact", "model_sha256": "0" * 64, "warnings": [], "settings": {"trees": {"bh_m": 1.3}},
    }  # fmt: skip
    (out / "plot.json").write_text(json.dumps(plot), encoding="utf-8")
    for number in (1, 2, 3):
        write_image(out / "figures" / f"tree_{number:03d}.png", np.full((300, 280, 3), 250, np.uint8))
    return out
