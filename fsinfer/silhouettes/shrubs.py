"""What the cloud took for a stem and the photographs do not: shrubs, and haze.

Only what the points are not sure of is asked; a stem that a photograph shows has edges that agree on a size.
"""

from __future__ import annotations

import numpy as np

from fsinfer.notices.stems import StemCode
from fsinfer.silhouettes.join_settings import SilhouetteJoinSettings
from fsinfer.silhouettes.one_look import Looked
from fsinfer.trees import Tree
from fsinfer.trees.diameter.silhouette import edge_contrast
from fsinfer.trees.search.giants import LEAST_ARC, THICK_M


def is_shrub(tree: Tree, looked: Looked, s: SilhouetteJoinSettings) -> bool:
    """Whether enough photographs show the place and no edges in them that agree on a stem."""
    photos, large = len(np.unique(looked.fitted.photo)), _large_photos(looked, s)
    if tree.status == "ok" or (photos < s.shrub_photos and large < s.large_photos):
        return False
    many = photos >= s.many_photos or large >= s.large_photos
    least = s.many_contrast if many else s.shrub_contrast
    if _is_sizeless(tree):
        least = max(least, s.sizeless_contrast)
    contrast = edge_contrast(looked.fitted, looked.stem.radius_m, taper=looked.stem.taper, settings=s.fit)
    return contrast < least or shows_no_edges_all_round(tree, looked, contrast, s)


def shows_no_edges_all_round(tree: Tree, looked: Looked, contrast: float, s: SilhouetteJoinSettings) -> bool:
    """Whether the points show most of a girth but no size, and many photographs no edges of it that stand out.

    A stem that is seen from all those sides has edges from several. Photographs count that show it large: of a thin
    stem far away they say little.
    """
    many = _large_photos(looked, s) >= s.shrub_photos
    return many and tree.status == "unmeasured" and tree.arc_coverage >= s.all_round and contrast < s.all_round_contrast


def is_arc_of_haze(tree: Tree, looked: Looked) -> bool:
    """Whether what would be a thick stem shows less than a giant of its girth, has no size, and both edges nowhere.

    What is as thick as that can be hidden from some photographs of a walk, hardly from all.
    """
    thick = looked.stem.radius_m > THICK_M and tree.arc_coverage < LEAST_ARC
    return thick and tree.status == "unmeasured" and len(looked.edges.photo) == 0


def _large_photos(looked: Looked, s: SilhouetteJoinSettings) -> int:
    """How many photographs show the stem large."""
    edges = looked.fitted
    return len(np.unique(edges.photo[edges.pixel_m * s.large_px <= looked.stem.radius_m]))


def _is_sizeless(tree: Tree) -> bool:
    """Whether the points leave the diameter open by more than the diameter itself."""
    said = [reason.values for reason in tree.reasons if reason.code == StemCode.too_uncertain]
    sizes = [(values["half_width_cm"], values["dbh_cm"]) for values in said]
    return any(isinstance(half, float) and isinstance(dbh, float) and half > dbh for half, dbh in sizes)
