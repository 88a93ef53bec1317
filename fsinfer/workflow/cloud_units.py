"""What is known of the cloud in an output folder: ``plot.json``, put right by the ledger where that is newer.

``plot.json`` is written at the end of a run. A run that was stopped before leaves a cloud that ``plot.json`` does not
know, or knows in another unit; the records of the stages that made the cloud are always those of the cloud.

Trees may be measured at another scale than that of the cloud's file (``fsinfer trees --scale``). Then ``plot.json`` has
the unit and scale of the trees, as its reader expects, and under ``cloud`` those of the file.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fsinfer.errors import InputError
from fsinfer.output.json_values import as_json
from fsinfer.output.layout import OutputFolder
from fsinfer.output.plot_json import OF_FILE, of_file, read_plot
from fsinfer.scale.scale import Scale
from fsinfer.workflow.cloud_stages import CLOUD, SCALE, PlotCloud
from fsinfer.workflow.ledger import Ledger, StageRecord
from fsinfer.workflow.single_stages import FUSE_SCENE, SceneCloud
from fsinfer.workflow.summary import MODEL_UNITS, PHOTO_KEYS

#: What ``plot.json`` tells of the cloud itself.
CLOUD_KEYS = (
    "units", "scale_m_per_unit", "scale_source", "scale_rel_std", "scale_details", "cloud_from_scene", "camera_height",
    "points", "density_per_m2",
)  # fmt: skip


def plot_of_cloud(folder: Path) -> dict[str, Any]:
    """Content of ``plot.json`` beside a cloud, in which ``CLOUD_KEYS`` are true for the cloud that lies there.

    Empty where nothing is known: such a cloud is of other origin.

    Raises
    ------
    InputError
        fsinfer was stopped while it wrote the cloud, and its unit cannot be told; or ``plot.json`` is damaged.
    """
    plot, ledger = of_file(read_plot(folder)), Ledger(folder)
    placed = ledger.recall(CLOUD)
    if placed is not None:
        inputs = ledger.inputs_of(CLOUD.name) or {}
        m_per_unit = inputs.get("m_per_unit")
        if _tells_of(plot, placed) and plot.get("scale_m_per_unit") == m_per_unit:
            return plot
        return plot | _of_records(ledger, placed, m_per_unit)
    fused = ledger.recall(FUSE_SCENE)
    # Its unit stands in plot.json alone, which is written right after it.
    known = _tells_of(plot, fused) if fused is not None else _cloud_was_changed(ledger, plot)
    if not known:
        raise _unknown(folder)
    return plot


def scale_of_trees(
    scale: Scale, before: Mapping[str, Any], out: Path, *, own_cloud: bool, density_per_m2: float | None
) -> dict[str, Any]:
    """What ``plot.json`` tells of trees that were measured at a ``scale`` of their own, or in another folder's cloud.

    Metres a unit are those of the scene, or of a cloud that came from none. ``before`` is what is known of the cloud's
    file in ``out``, which is kept under ``OF_FILE``; with ``PHOTO_KEYS`` where the trees are not of its photographs.
    Nothing changes for trees of that cloud as it is.
    """
    if own_cloud and scale.m_per_unit is None:
        return {OF_FILE: None}
    of_cloud = (before.get("scale_m_per_unit") if own_cloud else None) or 1.0
    told: dict[str, Any] = {
        "scale_m_per_unit": None if scale.m_per_unit is None else of_cloud * scale.m_per_unit,
        "scale_source": scale.source,
        "scale_rel_std": scale.rel_std,
        "scale_details": None if scale.details is None else as_json(scale.details),
    }
    if scale.m_per_unit is not None:
        told |= {"units": "m", "density_per_m2": density_per_m2}
    if not own_cloud:
        # They stand in a frame of their own: the photographs of this folder show other places.
        told |= dict.fromkeys((*PHOTO_KEYS, "cloud_from_scene", "camera_height"))
    there = own_cloud or OutputFolder(out).cloud_ply.exists() or OutputFolder(out).cloud_laz.exists()
    kept = CLOUD_KEYS if own_cloud else (*CLOUD_KEYS, *PHOTO_KEYS)
    return told | {OF_FILE: {key: before.get(key) for key in kept} if there or is_of_photos(before) else None}


def is_of_photos(plot: Mapping[str, Any]) -> bool:
    """Whether ``plot.json`` tells of photographs, by a run or by a scene."""
    return plot.get("photos") is not None or plot.get("cloud_from_scene") is not None


def _tells_of(plot: dict[str, Any], made: StageRecord[PlotCloud] | StageRecord[SceneCloud]) -> bool:
    """Whether ``plot.json`` has the cloud's own place in the scene."""
    told = np.asarray(plot.get("cloud_from_scene") or np.nan, dtype=np.float64)
    return told.shape == (4, 4) and bool(np.allclose(told, made.result.cloud_from_scene, rtol=1e-9, atol=1e-12))


def _of_records(ledger: Ledger, placed: StageRecord[PlotCloud], m_per_unit: float | None) -> dict[str, Any]:
    """``CLOUD_KEYS`` of a cloud that a run placed and did not come to tell of."""
    found = ledger.recall(SCALE)
    if found is None or found.result.scale.m_per_unit != m_per_unit:
        raise _unknown(ledger.out)
    scale = found.result.scale
    return {
        "units": MODEL_UNITS if m_per_unit is None else "m",
        "scale_m_per_unit": m_per_unit,
        "scale_source": scale.source,
        "scale_rel_std": scale.rel_std,
        "scale_details": {} if scale.details is None else as_json(scale.details),
        "cloud_from_scene": as_json(placed.result.cloud_from_scene),
        "camera_height": placed.result.camera_height,
        "points": placed.result.points,
        "density_per_m2": placed.result.density_per_m2,
    }


def _cloud_was_changed(ledger: Ledger, plot: dict[str, Any]) -> bool:
    """Whether the cloud, which is no longer what a stage wrote, has the unit of ``plot.json`` all the same.

    Somebody may have cut it, or taken a file of it away: only a stage that was stopped leaves the unit open.
    """
    if not (ledger.has(CLOUD.name) or ledger.has(FUSE_SCENE.name)):
        return True  # of other origin, or brought here without its records
    if ledger.has(CLOUD.name):
        inputs = ledger.inputs_of(CLOUD.name)
        return inputs is not None and "units" in plot and plot.get("scale_m_per_unit") == inputs.get("m_per_unit")
    return ledger.inputs_of(FUSE_SCENE.name) is not None and "units" in plot


def _unknown(folder: Path) -> InputError:
    return InputError(
        f"whether the cloud in {folder} is in metres is not known, because fsinfer was stopped there before it was "
        "finished; run the same command again to finish it, or copy a cloud of other origin into a folder of its own"
    )
