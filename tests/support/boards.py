"""Scales by markers as the marker measurement returns them."""

from __future__ import annotations

from collections.abc import Sequence

from fsinfer.scale.scale import MarkerDetails, MarkerScale, RejectedMarker, Scale


def board(
    number: int,
    center: tuple[float, float, float],
    views: Sequence[str],
    *,
    length_m: float = 0.25,
    m_per_unit: float = 1.0,
    near_side_px: float = 80.0,
    normal: tuple[float, float, float] | None = None,
) -> MarkerScale:
    """One marker at ``center`` (scene units), seen in ``views``, that agrees with all others."""
    return MarkerScale(
        id=number,
        views=tuple(views),
        center=center,
        length_m=length_m,
        side_units=length_m / m_per_unit,
        m_per_unit=m_per_unit,
        rel_std=0.001,
        residual_rel=0.0,
        residual_mm=0.0,
        error_px=0.2,
        near_side_px=near_side_px,
        angle_deg=30.0,
        leave_one_out_m_per_unit=None,
        leave_one_out_rel=None,
        normal=normal,
    )


def scale_of_boards(
    boards: Sequence[MarkerScale],
    *,
    m_per_unit: float | None = 1.0,
    rel_std: float = 0.01,
    length_m: float | None = None,
    rejected: tuple[RejectedMarker, ...] = (),
) -> Scale:
    """The scale that these markers give."""
    details = MarkerDetails(
        photos_searched=40,
        photos_with_markers=20,
        dictionary="4X4_50",
        length_m=length_m,
        rejected=rejected,
        mean_side_px=60.0,
        edge_rel_std=0.002,
        markers=tuple(boards),
    )
    return Scale(m_per_unit=m_per_unit, source="aruco", rel_std=rel_std, details=details)
