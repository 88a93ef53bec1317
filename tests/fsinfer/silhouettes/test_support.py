"""What else has the size of a stem that the cloud refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fsinfer.notices.notice import Notice, notice
from fsinfer.notices.stems import StemCode
from fsinfer.silhouettes.one_look import Looked
from fsinfer.silhouettes.support import SupportSettings, is_supported, points_support
from fsinfer.trees import Section
from fsinfer.trees.diameter.edge_set import Edges
from fsinfer.trees.diameter.second_pair import second_pair
from fsinfer.trees.diameter.section import unmeasured_section
from fsinfer.trees.diameter.silhouette import fit_silhouette
from fsinfer.trees.diameter.silhouette_settings import SilhouetteSettings
from tests.fsinfer.silhouettes.test_looks import NONE, NOWHERE, UPRIGHT, fit_of
from tests.fsinfer.trees.diameter.test_second_pair import edges_of, together

SEEN_LITTLE = notice(StemCode.too_little_seen, seen_deg=50.0)


def refused(radius: float, *reasons: Notice) -> Section:
    """A section that the cloud refused though its points have a circle of ``radius``."""
    section = unmeasured_section(np.zeros(2), 1.3, reasons, radius_m=radius)
    return replace(section, parts_m={"fit": 0.008})


def seen_from(directions_deg: list[float], radius: float = 0.06, *, seed: int = 0) -> Looked:
    edges: Edges = edges_of(radius, directions_deg, rng=np.random.default_rng(seed))
    stem = replace(UPRIGHT, radius_m=radius, taper=-0.008)
    fit = fit_silhouette(edges, radius, taper=stem.taper)
    return Looked(stem=stem, edges=edges, single=NONE, fitted=edges, of_fit=edges, fit=fit, moved_m=NOWHERE)


def test_points_that_were_refused_may_still_agree_on_the_size() -> None:
    enough = SupportSettings().points_std
    section = refused(0.145, SEEN_LITTLE)
    assert points_support(section, 0.008, fit_of(0.15, 0.002), enough)
    assert not points_support(section, 0.008, fit_of(0.10, 0.002), enough)
    assert not points_support(section, 0.03, fit_of(0.15, 0.002), 0.19)
    assert points_support(section, 0.03, fit_of(0.15, 0.002), 0.21)
    walls = refused(0.145, notice(StemCode.double_wall, gap_cm=3.0))
    assert not points_support(walls, 0.008, fit_of(0.15, 0.002), enough)
    by_hand = refused(0.145, notice(StemCode.added_by_hand), *walls.reasons)
    assert not points_support(by_hand, 0.008, fit_of(0.15, 0.002), enough)


#: Of the radius; directions of the photographs, whose parts are 24, 14 and 70 degrees apart.
VAGUE, TOO_VAGUE = 0.25, 0.35
ALMOST = [0.0, 3.0, 6.0, 9.0, 24.0, 27.0, 30.0, 33.0]
NARROW = [0.0, 3.0, 6.0, 9.0, 14.0, 17.0, 20.0, 23.0]
WIDE = [0.0, 3.0, 6.0, 9.0, 70.0, 73.0, 76.0, 79.0]


@pytest.mark.parametrize(
    ("directions", "points_share", "points_radius", "supported"),
    [
        (ALMOST, VAGUE, 0.065, True),  # each by itself is not enough
        (ALMOST, TOO_VAGUE, 0.065, False),
        (ALMOST, VAGUE, 0.12, False),
        (NARROW, VAGUE, 0.065, False),
        (NARROW, 0.15, 0.065, True),
        (WIDE, TOO_VAGUE, 0.12, True),
    ],
)
def test_two_half_supports_are_one(
    directions: list[float], points_share: float, points_radius: float, supported: bool
) -> None:
    """A stem of 9 cm seen by 48 photographs had no DBH: its parts looked from 29 degrees apart where 30 are asked."""
    looked = seen_from(directions)
    assert looked.fit is not None
    section = refused(points_radius, SEEN_LITTLE)
    std = points_share * looked.fit.radius_m
    assert is_supported(section, std, looked, looked.fit, silhouette=SilhouetteSettings()) == supported


def test_parts_of_two_sizes_are_no_half_support() -> None:
    one, other = seen_from(ALMOST[:4], 0.05), seen_from(ALMOST[4:], 0.075, seed=1)
    rays = other.edges.ray + 1000
    both = Edges(
        **{
            name: np.concatenate([getattr(one.edges, name), rays if name == "ray" else getattr(other.edges, name)])
            for name in vars(one.edges)
            if name != "photo"
        },
        photo=np.concatenate([one.edges.photo, other.edges.photo + 100]),
    )
    looked = replace(one, edges=both, fitted=both)
    fit = fit_of(0.06, 0.002)
    section = refused(0.065, SEEN_LITTLE)
    assert not is_supported(section, VAGUE * 0.06, looked, fit, silhouette=SilhouetteSettings())


def test_what_the_cloud_measured_needs_no_support() -> None:
    looked = seen_from(NARROW)
    section = replace(refused(0.065), dbh_m=0.13)
    assert is_supported(section, 1.0, looked, fit_of(0.06, 0.002), silhouette=SilhouetteSettings())


def test_small_pictures_that_spoil_a_second_pair_are_left_out_of_it() -> None:
    """All photographs beside those that show the stem large: the others have their edges anywhere."""
    large = seen_from(WIDE)
    rng = np.random.default_rng(5)
    small = edges_of(0.06, np.arange(5.0, 175.0, 7.0).tolist(), rng=rng, photo=20)
    small = replace(small, support_m=rng.uniform(0.0, 0.15, len(small.ray)))
    spoilt = replace(large, edges=together(large.edges, small))
    section = refused(0.2, notice(StemCode.double_wall, gap_cm=3.0))
    assert large.fit is not None
    for looked, supported in ((large, True), (spoilt, True), (replace(spoilt, fitted=spoilt.edges), False)):
        assert is_supported(section, 0.01, looked, large.fit, silhouette=SilhouetteSettings()) is supported


@pytest.mark.parametrize(("share", "supported"), [(0.79, False), (0.81, True)])
def test_edges_that_a_fifth_of_the_rays_contradicts_are_supported_by_nothing(share: float, supported: bool) -> None:
    """Twigs of a shrub made a stem of 81 cm, half of the demo's basal area."""
    looked = seen_from(WIDE)
    assert looked.fit is not None
    fit = replace(looked.fit, share=share)
    section = refused(0.06, SEEN_LITTLE)
    assert is_supported(section, 0.002, looked, fit, silhouette=SilhouetteSettings()) is supported


def ragged(seed: int, scatter_m: float = 0.01) -> Looked:
    """Photographs of leaves, whose edges lie about those of a stem of 11 cm by ``scatter_m``."""
    whole = seen_from(WIDE, 0.055, seed=seed)
    beside = np.random.default_rng(100 + seed).normal(0.0, scatter_m, len(whole.edges.ray))
    edges = replace(whole.edges, support_m=whole.edges.support_m + beside)
    fit = fit_silhouette(edges, 0.055, taper=whole.stem.taper)
    return replace(whole, edges=edges, fitted=edges, of_fit=edges, fit=fit)


@pytest.mark.parametrize("seed", [1, 7])
def test_a_second_pair_of_ragged_edges_supports_nothing(seed: int) -> None:
    """Leaves beside a sapling of 2.6 cm made 10.5 cm +- 2.2 cm of it, their edges agreed from two sides."""
    leaves = ragged(seed)
    bark = ragged(seed, 0.001)
    assert leaves.fit is not None
    assert bark.fit is not None
    assert second_pair(leaves.edges, 0.055, taper=leaves.stem.taper).agree
    points_of_another_size = refused(0.12, SEEN_LITTLE)
    for looked, supported in ((leaves, False), (bark, True)):
        assert looked.fit is not None
        found = is_supported(points_of_another_size, 0.008, looked, looked.fit, silhouette=SilhouetteSettings())
        assert found is supported
    # A crooked stem has ragged edges, too; its points know.
    points_of_that_size = refused(leaves.fit.radius_m, SEEN_LITTLE)
    assert is_supported(points_of_that_size, 0.008, leaves, leaves.fit, silhouette=SilhouetteSettings())
