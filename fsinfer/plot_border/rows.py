"""The plot's figures as rows of a sheet: names as in ``plot.json``, values as numbers."""

from __future__ import annotations

from fsinfer.plot_border.hectare import HectareFigure
from fsinfer.plot_border.plot import PlotFigures

Row = tuple[str, str | int | float | None]


def figure_rows(figures: PlotFigures) -> list[Row]:
    """Name and value of each figure, with the ends of its intervals."""
    rows: list[Row] = [("border_round", figures.origin)]
    if figures.center is not None:
        rows += [("center_x_m", figures.center[0]), ("center_y_m", figures.center[1])]
    rows += [
        ("radius_m", figures.radius_m),
        ("area_m2", figures.area_m2),
        ("seen_share", figures.seen_share),
        ("slope_deg", figures.slope_deg),
        ("stems", figures.stems),
        ("stems_measured", figures.measured),
        ("stems_doubtful", figures.doubtful),
        ("stems_without_dbh", figures.unmeasured),
        ("stems_on_unseen_ground", figures.on_unseen),
        ("stems_outside", figures.outside),
        ("stems_at_border", len(figures.border_cases)),
        ("quadratic_mean_dbh_cm", figures.quadratic_mean_dbh_cm),
        ("mean_dbh_cm", figures.mean_dbh_cm),
    ]
    for name, figure, doubtful in (
        ("stems", figures.stems_per_ha, figures.doubtful_stems_per_ha),
        ("basal_area_m2", figures.basal_area_m2_per_ha, figures.doubtful_basal_area_m2_per_ha),
    ):
        empty = name == "basal_area_m2" and figures.no_basal_area
        rows += [(f"{name}_per_ha", 0.0)] if empty else _of(name, figure)
        rows.append((f"{name}_of_doubtful_per_ha", doubtful))
    return rows


def _of(name: str, figure: HectareFigure | None) -> list[Row]:
    if figure is None:
        return [(f"{name}_per_ha", None)]
    return [
        (f"{name}_per_ha", figure.value),
        (f"{name}_lo95_per_ha", figure.lo95),
        (f"{name}_hi95_per_ha", figure.hi95),
        (f"{name}_of_the_stand_lo95_per_ha", figure.stand_lo95),
        (f"{name}_of_the_stand_hi95_per_ha", figure.stand_hi95),
    ]
