"""Feature maps that a graph gives out in levels of 8 bits."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.depth.map_levels import MapLevels, features_of
from fsinfer.depth.model import DepthModel
from fsinfer.errors import ModelError
from tests.support.int8_features import photograph, with_notes

LEVELS = MapLevels(scale=0.06, zero_point=119)


def levels_of(seed: int, *shape: int) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 256, shape).astype(np.uint8)


def test_each_level_is_its_number_in_its_place() -> None:
    levels = levels_of(0, 6, 10, 12)
    found = features_of(levels[None], LEVELS, 10).to_chw()
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, (levels.transpose(2, 0, 1) - 119.0) * 0.06, rtol=1e-6, atol=1e-9)


def test_what_lies_behind_the_width_is_left_out() -> None:
    levels = levels_of(1, 5, 12, 8)
    wide, narrow = (features_of(levels[None], LEVELS, width) for width in (12, 9))
    assert narrow.shape == (5, 9)
    assert all(group.flags.c_contiguous for group in narrow.groups)
    np.testing.assert_array_equal(narrow.to_chw(), wide.to_chw()[..., :9])


def test_numbers_of_32_bits_are_taken_as_they_are() -> None:
    maps = np.random.default_rng(2).normal(size=(1, 8, 5, 7)).astype(np.float32)
    np.testing.assert_array_equal(features_of(maps, None, 7).to_chw(), maps[0])


@pytest.mark.parametrize(
    ("output", "levels"),
    [
        (levels_of(3, 1, 5, 7, 8), LEVELS),  # less wide
        (levels_of(3, 1, 5, 8, 6), LEVELS),  # no multiple of four
        (levels_of(3, 5, 8, 8), LEVELS),
        (np.zeros((1, 0, 8, 8), np.uint8), LEVELS),
        (np.zeros((1, 8, 5, 8), np.float32), LEVELS),
        (np.zeros((1, 6, 5, 8), np.float32), None),
        (np.zeros((8, 5, 8), np.float32), None),
    ],
)
def test_other_shapes_are_refused(output: NDArray[Any], levels: MapLevels | None) -> None:
    with pytest.raises(ValueError, match="multiple of"):
        features_of(output, levels, 8)


def test_levels_that_are_noted_are_read_again_for_their_output_alone() -> None:
    notes = LEVELS.notes("half")
    assert MapLevels.noted(notes, "half") == LEVELS
    assert MapLevels.noted(notes, "quarter") is None


@pytest.mark.parametrize(
    "changed",
    [{"half_scale": "0"}, {"half_scale": "nan"}, {"half_zero_point": "256"}, {"half_zero_point": "1.5"}],
)
def test_levels_that_cannot_be_are_refused(changed: dict[str, str]) -> None:
    with pytest.raises(ValueError, match="its levels of half are"):
        MapLevels.noted(LEVELS.notes("half") | changed, "half")


@pytest.mark.parametrize("width", [240, 242, 243, 245])
def test_features_in_8_bits_are_as_large_as_those_of_32(width: int) -> None:
    image = np.ascontiguousarray(photograph(60)[:, :width])
    exact, quick = (DepthModel.load("cascade", threads=1, precision=way).features(image) for way in ("float32", "int8"))
    for one, other in ((exact.quarter, quick.quarter), (exact.half, quick.half)):
        assert one is not None
        assert other is not None
        wanted, found = one.to_chw(), other.to_chw()
        assert found.shape == wanted.shape
        # Four pixels are one: where that leaves a column behind the last, those before it see the mean there.
        untouched = wanted.shape[2] if width % 4 in (0, 3) else wanted.shape[2] - 8
        difference = np.abs(found - wanted).mean(axis=(0, 1))
        assert (difference[:untouched] < 0.25 * np.abs(wanted).mean()).all()


def test_a_graph_whose_maps_have_no_notes_is_refused(tmp_path: Path) -> None:
    manifest = with_notes(tmp_path, lambda notes: {k: v for k, v in notes.items() if not k.startswith("half")})
    model = DepthModel.load(manifest, threads=1, precision="int8")
    with pytest.raises(ModelError, match=r"the features of model field.*re-export"):
        model.features(levels_of(5, 64, 96, 3))


def test_a_graph_whose_notes_cannot_be_is_refused(tmp_path: Path) -> None:
    manifest = with_notes(tmp_path, lambda notes: notes | {"half_scale": "-1"})
    with pytest.raises(ModelError, match=r"field_features_int8.*its levels of half are.*re-export"):
        DepthModel.load(manifest, threads=1, precision="int8")
