"""The constants of the ground's finding."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class GroundSettings:
    """Constants of :func:`~fsinfer.trees.ground.ground.find_ground`.

    Attributes
    ----------
    tolerance_m: points within it are ground; between the two it follows the noise. Source: Forests 2025, 16, 927.
    cell_m: below the 0.5-1 m of usual terrain rasters, so that root collars and bumps follow. Source: not recorded.
    layer_m: height bins in which the lowest dense layer of a cell is looked for. Source: not recorded.
    search_m: the lowest dense layer lies at most this far above the lowest point of its cell. Source: not recorded.
    dense_share: a layer is dense with this share of what the fullest of them holds. Source: not recorded.
    filter_radius_m: within this distance of a stem foot the ground cannot hide in a crown. Source: not recorded.
    filter_slack_m: stones, roots and noise may stand above what the slope allows. Source: not recorded.
    max_slope_deg: of levelled clouds; steeper is a wall or a cloud that is not z up. Source: not recorded.
    terrace_step_m: neighbouring cells of level ground differ by no more. Source: geometry; a slope of 27 degrees.
    terrace_share, terrace_cells: such a stretch can be ground as a whole where this share of its cells can be, and so
        many. Source: judgement; half of a terrace, and ten square metres.
    terrace_hidden: and so many of them cannot be, by the slope: it lies above a bank. Source: judgement.
    agree_m: cells so near to the surface agree with it. Source: not recorded.
    band_m: points so near to the surface make its second, finer form; wider where noise is. Source: not recorded.
    plane_share: the plane alone is believed when this share of the cells lies within ``plane_tolerance_m``, and the
        surface through all of them does everywhere. Source: not recorded.
    plane_tolerance_m: 3 cm of height cost 0.5 mm of a tapering stem's diameter. Source: geometry.
    open_m: half the width of undergrowth that may hide the ground, cut off before a surface is laid through what is
        left. Source: shapes of relief and undergrowth (``python -m tests.bench.relief``).
    smoothness: weight of squared second differences against one cell's height; the second, finer surface's.
        Source: as ``open_m``.
    well_seen: a cell with this share of the points of the median cell counts as much as any; the same for the finer
        surface. Source: renders only, a plot of 1,000 photographs, at whose border 26 points of haze stood for the
        ground round a stem, and the feet of 116 stems of four undergrown plots (docs/trials-accuracy.md).
    hold: weight, against one cell's, with which the finer surface keeps to the stiffer one: beyond the last ground that
        was seen it would go on as steep as it began. Source: as ``well_seen``.
    rounds: of the finer surface, each through the points near the one before. Source: as ``open_m``.
    sure_ground_share: more of the lowest cells than this on a surface, and it is one; else it has to foretell the cells
        that it was not laid through. Source: random blocks of points, of which 0.3 to 0.65 lie on it.
    min_ground_share: fewer of the lowest cells than this on one surface: no ground was seen. Source: not recorded.
    """

    tolerance_m: tuple[float, float] = (0.02, 0.05)
    cell_m: float = 0.4
    layer_m: float = 0.05
    search_m: float = 1.0
    dense_share: float = 0.15
    filter_radius_m: float = 3.0
    filter_slack_m: float = 0.3
    max_slope_deg: float = 40.0
    terrace_step_m: float = 0.2
    terrace_share: float = 0.5
    terrace_cells: int = 64
    terrace_hidden: int = 4
    agree_m: float = 0.15
    band_m: float = 0.08
    plane_share: float = 0.9
    plane_tolerance_m: float = 0.03
    open_m: float = 1.0
    smoothness: tuple[float, float] = (2.0, 0.2)
    well_seen: tuple[float, float] = (0.2, 1.0)
    hold: float = 0.01
    rounds: int = 3
    sure_ground_share: float = 0.8
    min_ground_share: float = 0.3
