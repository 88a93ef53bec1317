"""What is to be told of estimates for the forest that plots sample."""

from __future__ import annotations

from enum import StrEnum

#: Names of plots or strata that a sentence lists. Source: layout; a line or two of a terminal.
MOST_NAMES = 12


class SampleCode(StrEnum):
    """What estimates leave out, and what they do not say."""

    no_borders = "no_borders"
    no_plot_counts = "no_plot_counts"
    plots_left_out = "plots_left_out"
    # Why plots are left out.
    left_failed = "left_failed"
    left_waiting = "left_waiting"
    left_without_scale = "left_without_scale"
    left_without_border = "left_without_border"
    left_hardly_seen = "left_hardly_seen"
    # What else is to be known.
    basal_area_unknown = "basal_area_unknown"
    one_plot = "one_plot"
    no_stems = "no_stems"
    strata_without_area = "strata_without_area"
    strata_without_plots = "strata_without_plots"
    strata_without_basal_area = "strata_without_basal_area"
    strata_of_one_plot = "strata_of_one_plot"
    strata_smaller_than_plots = "strata_smaller_than_plots"


#: Why plots are left out, in the order in which it is said.
REASONS = (
    SampleCode.left_failed,
    SampleCode.left_waiting,
    SampleCode.left_without_scale,
    SampleCode.left_without_border,
    SampleCode.left_hardly_seen,
)
#: What each code says; ``{name}`` is filled with the notice's values.
SENTENCES: dict[SampleCode, str] = {
    SampleCode.no_borders: (
        "no plot has a border, so that the forest is not estimated from them: seen ground has no size that was chosen "
        "beforehand; give plot_radius_m or plot_polygon in the table of plots; where one is given, the plot's warnings "
        "say why it has no border"
    ),
    SampleCode.no_plot_counts: "no plot counts ({why}), so that the forest is not estimated",
    SampleCode.plots_left_out: (
        "left out: {plots} of {of} plots ({why}); the estimates are right only as far as it is by chance which ones "
        "are missing"
    ),
    SampleCode.left_failed: "{plots} failed: {names}",
    SampleCode.left_waiting: "{plots} not yet measured: {names}",
    SampleCode.left_without_scale: "{plots} without a scale: {names}",
    SampleCode.left_without_border: "{plots} without a border: {names}",
    SampleCode.left_hardly_seen: "{plots} of which too little was seen: {names}",
    SampleCode.basal_area_unknown: (
        "basal area and mean diameters are without {plots:plot|plots} whose basal area is not known ({names}), which "
        "the stems a hectare count; they are right only as far as it is by chance which ones are missing"
    ),
    SampleCode.one_plot: "one plot alone tells nothing of the spread between plots: there is no standard error",
    SampleCode.no_stems: (
        "no stem stands on any of these plots: their standard error of 0 says that they are alike, not that the forest "
        "has no stems"
    ),
    SampleCode.strata_without_area: (
        "no stratum_ha is given for {names}: the figures of all plots leave strata aside, as if the plots had been "
        "placed over the whole forest alike"
    ),
    SampleCode.strata_without_plots: (
        "no plot counts in stratum {names}: the figures of all strata, and their totals, are of the other ones alone"
    ),
    SampleCode.strata_without_basal_area: (
        "no plot of stratum {names} has a basal area: there is none of all strata together"
    ),
    SampleCode.strata_of_one_plot: (
        "a single plot counts in stratum {names}: there is no standard error of it, nor of all by strata; put it to "
        "one that is like it, or measure a second plot there"
    ),
    SampleCode.strata_smaller_than_plots: (
        "stratum {names} has less area than its plots: stratum_ha is in hectares, that of the whole stratum"
    ),
}
