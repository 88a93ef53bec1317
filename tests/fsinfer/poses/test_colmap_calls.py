"""Failures of COLMAP are told apart from faults of ours."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fsinfer.errors import PosesError
from fsinfer.poses.colmap import colmap_errors, extract_features
from fsinfer.poses.colmap_calls import ColmapError, call, copy_for_mapping, open_database
from fsinfer.poses.settings import PoseSettings
from fsinfer.progress import silent

pycolmap = pytest.importorskip("pycolmap")


@pytest.fixture
def synthetic(tmp_path: Path) -> Path:
    """A database of a few photographs of points."""
    options = pycolmap.SyntheticDatasetOptions()
    options.num_frames_per_rig, options.num_points3D = 5, 200
    with pycolmap.Database.open(tmp_path / "database.db") as opened:
        pycolmap.synthesize_dataset(options, opened)
    return tmp_path / "database.db"


@pytest.mark.parametrize("kind", [RuntimeError, ValueError, IndexError, KeyError, TypeError])
def test_a_fault_of_ours_between_the_calls_stays_one(kind: type[Exception], tmp_path: Path) -> None:
    with pytest.raises(kind, match="ours"), colmap_errors("finding poses", tmp_path):
        raise kind("ours")


@pytest.mark.parametrize("kind", [RuntimeError, ValueError, IndexError])
def test_a_fault_of_ours_in_a_callback_stays_one(kind: type[Exception], synthetic: Path, tmp_path: Path) -> None:
    def report() -> None:
        raise kind("ours")

    (tmp_path / "models").mkdir()
    with pytest.raises(kind, match="ours"), colmap_errors("finding poses", tmp_path):
        call(pycolmap.incremental_mapping, synthetic, tmp_path, tmp_path / "models", next_image_callback=report)


def test_a_failure_of_colmap_says_what_to_do(tmp_path: Path) -> None:
    work = tmp_path / "work"
    told = r"finding poses failed in COLMAP \(.*does not exist.*delete .*work and run"
    with pytest.raises(PosesError, match=told), colmap_errors("finding poses", work):
        call(pycolmap.incremental_mapping, tmp_path / "none.db", tmp_path, tmp_path)


def test_a_damaged_database_is_a_failure_of_colmap(tmp_path: Path) -> None:
    database = tmp_path / "database.db"
    database.write_bytes(b"no database" * 100)
    with pytest.raises(PosesError, match="delete"), colmap_errors("finding poses", tmp_path):
        extract_features(database, tmp_path, {"camera": ["a.jpg"]}, PoseSettings(), silent)


def test_methods_of_a_database_are_calls_of_colmap(synthetic: Path) -> None:
    with open_database(synthetic) as opened:
        assert opened.num_images() == 10  # two cameras on each of five rigs
        assert opened.read_image(1).image_id == 1
    with pytest.raises(ColmapError):
        opened.num_images()  # closed


def test_arguments_that_do_not_fit_are_a_fault_of_ours(synthetic: Path) -> None:
    with pytest.raises(TypeError), open_database(synthetic) as opened:
        opened.read_image("one")


def test_what_is_called_gets_its_arguments() -> None:
    def work(*arguments: Any, **options: Any) -> tuple[Any, Any]:
        return arguments, options

    assert call(work, 1, 2, three=3) == ((1, 2), {"three": 3})


def test_a_copy_for_mapping_is_mapped_alike_and_has_no_descriptors(synthetic: Path, tmp_path: Path) -> None:
    copy = tmp_path / "a 'copy'.db"
    copy.write_text("of before")
    with open_database(synthetic) as opened:
        numbers = [image.image_id for image in opened.read_all_images()]
        opened.delete_two_view_geometry(*numbers[:2])
        # What is still in its log is copied, too.
        copy_for_mapping(synthetic, copy)
        assert opened.num_descriptors() > 0
    with open_database(synthetic) as opened, open_database(copy) as copied:
        assert copied.num_descriptors() == 0
        for what in ("num_rigs", "num_cameras", "num_frames", "num_images", "num_keypoints", "num_inlier_matches"):
            assert getattr(copied, what)() == getattr(opened, what)() > 0
        assert copied.read_all_cameras() == opened.read_all_cameras()
        assert [image.name for image in copied.read_all_images()] == [image.name for image in opened.read_all_images()]
    models = []
    for database in (synthetic, copy):
        options = pycolmap.IncrementalPipelineOptions(num_threads=1, random_seed=1)
        (model,) = pycolmap.incremental_mapping(database, tmp_path, tmp_path, options=options).values()
        models.append([model.images[i].cam_from_world().matrix() for i in sorted(model.reg_image_ids())])
    assert np.array_equal(models[0], models[1])
