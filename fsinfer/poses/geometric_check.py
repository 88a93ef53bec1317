"""COLMAP's geometric check of matches: how many of a pair's agree on one fundamental matrix or homography.

A pair counts with :data:`~fsinfer.poses.pairs.MIN_INLIERS` matches that agree. Of a pair with few matches most must
then be right, and so few random samples tell that they are not: of 20 matches, three quarters. COLMAP does not draw
that conclusion, and spends half of its time on pairs that do not belong together (docs/trials-speed.md).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from fsinfer.poses.colmap_calls import SEED, call, open_database
from fsinfer.poses.pairs import MIN_INLIERS

#: Random samples of a pair at most; of many matches that is the limit. With COLMAP's 10,000 the check takes as long as
#: matching. Source: numerics; 360 pairs of a rendered plot: 6.4 s with 10,000 against 3.0, 281 pairs and 92,629 matches
#: against 279 and 92,574; renders only.
_MOST_SAMPLES = 2500
#: Pairs with at most so many matches are checked together; what of these agrees at least when a pair counts limits the
#: samples. Above, :data:`_MOST_SAMPLES` are fewer. Source: numerics.
_FEW_MATCHES = (18, 21, 25, 29)


def check_pairs(database: Path, pairs: Sequence[tuple[str, str]], threads: int) -> None:
    """Check the matches that the database has of ``pairs`` of photos, by their names, which hold no spaces.

    What agrees is in the database afterwards; pairs that were checked before are not checked again.
    """
    import pycolmap

    options = pycolmap.FeatureMatchingOptions()
    options.use_gpu = False
    options.num_threads = threads
    listed = database.parent / "pairs.txt"
    for least_share, group in _by_least_share(database, pairs):
        verification = pycolmap.TwoViewGeometryOptions()
        verification.min_num_inliers = MIN_INLIERS
        verification.ransac.random_seed = SEED
        verification.ransac.max_num_trials = _MOST_SAMPLES
        verification.ransac.min_inlier_ratio = max(verification.ransac.min_inlier_ratio, least_share)
        listed.write_text("".join(f"{first} {second}\n" for first, second in group), encoding="utf-8")
        pairing = pycolmap.ImportedPairingOptions()
        pairing.match_list_path = listed
        call(
            pycolmap.match_image_pairs,
            database,
            matching_options=options,
            pairing_options=pairing,
            verification_options=verification,
            device=pycolmap.Device.cpu,
        )


def _by_least_share(database: Path, pairs: Sequence[tuple[str, str]]) -> Iterator[tuple[float, list[tuple[str, str]]]]:
    """Pairs of about as many matches, and the least share of these that agrees where one of the pairs counts."""
    groups: dict[float, list[tuple[str, str]]] = {}
    with open_database(database) as opened:
        number = {image.name: image.image_id for image in opened.read_all_images()}
        for first, second in pairs:
            matches = len(opened.read_matches(number[first], number[second]))
            few = next((limit for limit in _FEW_MATCHES if matches <= limit), None)
            groups.setdefault(0.0 if few is None else MIN_INLIERS / few, []).append((first, second))
    yield from sorted(groups.items())
