"""What the search for a stem's edges in photographs assumes."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class EdgeSettings:
    """Constants of :func:`fsinfer.silhouettes.edges.find_edges`; lengths in metres.

    "Two renders" are the open and the sloped plot.

    Attributes
    ----------
    light_power: edges are looked for in grey values, 0 to 1, to this power. Blur of lens and motion mixes light, which
        is their power of 2.2; making smaller, sharpening and tone mapping mix the values themselves. In the values a
        dark stem before a bright wood comes out too thin, in light too thick. Source: renders only, 1.5 makes stems of
        two plots without blur too thick; on undergrown ones with a phone's it made up for their ground, which was too
        high (docs/trials-accuracy.md).
    half_length_m: of the strip: long enough to average, short enough for a straight axis. Source: renders only, strips
        of 30 to 80 cm are all the same (docs/accuracy.md).
    band_m: in which gradients are averaged, a sixth of the strip. Source: renders only, two renders.
    margin: the strip reaches this many radii ... Source: renders only, two renders.
    margin_m: ... and this much to either side. Source: renders only, two renders.
    max_distance_m: beyond, a pixel of a phone is 2 cm. Source: renders only, a blind plot afterwards (955019): at 16 a
        stem of 24 cm that stands beside the path has no DBH, since the fifteen photographs of its other half were
        taken from 16.1 to 16.5 m.
    min_radius_px: of a stem in the photograph. Source: renders only, five plots (docs/trials-accuracy.md): at 3 a stem
        of 8 cm lacks its second pair of sides.
    blur_px: of the derivative. Source: renders only, two renders.
    clip: standard deviations of the bark, beyond which an edge is not surer. Source: renders only, two renders.
    inner: of the radius: surely bark. Source: renders only, two renders.
    floor: grey values per pixel that count as noise of the camera. Source: renders only, two renders.
    min_strength: of an edge, standard deviations of the bark. Source: renders only, two renders.
    min_seen: share of the near side at which the depth map shows the stem. Source: renders only, two renders.
    max_hidden: share behind something nearer. Source: renders only, two renders.
    half_seen: as ``min_seen``, of the half of the near side that belongs to an edge, where the photograph does not show
        both edges. Source: renders only, 74 stems of six plots (docs/trials-accuracy.md, "Sharp faces").
    tolerance_of_depth: of the depth map, share of the depth. Source: renders only, two renders.
    inside: where an edge is asked by :func:`fsinfer.silhouettes.edge_depths.may_be_edges` whether the stem is there,
        from and to so many radii inside of it. Source: renders only, seven plots, which hang little on it
        (docs/trials-accuracy.md, "Edges of others").
    outside: and from and to so many outside, whether something stands before the stem. Source: as ``inside``.
    asked: places on each side. Source: numerics.
    beyond_radii: what lies so many radii behind the axis is not the stem, and what is as much nearer than its near side
        stands before it. Source: as ``inside``.
    fringe_px: depth maps go on so far beside what is nearer, pixels of the picture that they were computed from: of a
        larger photograph it is as much more as that was reduced. Source: as ``inside``.
    against: share of the places on one side that make an edge another's. Source: as ``inside``.
    """

    light_power: float = 1.0
    half_length_m: float = 0.25
    band_m: float = 0.0834
    margin: float = 1.6
    margin_m: float = 0.04
    max_distance_m: float = 20.0
    min_radius_px: float = 2.5
    blur_px: float = 1.2
    clip: float = 20.0
    inner: float = 0.7
    floor: float = 0.5
    min_strength: float = 1.2
    min_seen: float = 0.5
    max_hidden: float = 0.2
    half_seen: float = 0.6
    tolerance_of_depth: float = 0.05
    inside: tuple[float, float] = (0.15, 0.45)
    outside: tuple[float, float] = (0.1, 0.4)
    asked: int = 4
    beyond_radii: float = 0.5
    fringe_px: float = 2.0
    against: float = 0.75
