"""What the dendrometry has to tell of a plot and of each tree."""

from __future__ import annotations

from enum import StrEnum


class StemCode(StrEnum):
    """Warnings of the tree stage, its diagnosis, and reasons for a tree's status."""

    # Why a tree has no diameter.
    no_scale = "no_scale"
    too_few_at_breast_height = "too_few_at_breast_height"
    too_few_on_bark = "too_few_on_bark"
    too_little_seen = "too_little_seen"
    double_wall = "double_wall"
    too_rough = "too_rough"
    too_uncertain = "too_uncertain"
    not_round = "not_round"
    in_pieces = "in_pieces"
    no_stem_here = "no_stem_here"
    ends_low = "ends_low"
    edges_unsupported = "edges_unsupported"
    edges_ragged = "edges_ragged"
    edges_unsure = "edges_unsure"
    stands_across = "stands_across"
    outside_walk = "outside_walk"
    # Why a diameter is doubtful.
    above_breast_height = "above_breast_height"
    below_breast_height = "below_breast_height"
    ground_unsure = "ground_unsure"
    little_seen = "little_seen"
    wide_interval = "wide_interval"
    far_from_round = "far_from_round"
    blurred_points = "blurred_points"
    rougher_than_others = "rougher_than_others"
    forks_here = "forks_here"
    top_seen = "top_seen"
    hangs = "hangs"
    edges_alone = "edges_alone"
    faint_edges = "faint_edges"
    few_edges = "few_edges"
    points_alone = "points_alone"
    sources_disagree = "sources_disagree"
    parts_disagree = "parts_disagree"
    boards_elsewhere = "boards_elsewhere"
    # What else is said of a tree.
    added_by_hand = "added_by_hand"
    merged_by_hand = "merged_by_hand"
    #: A reason that was read back as text, from a table.
    as_written = "as_written"
    # Why a stem curve has no diameter at a height; it may say ``little_seen`` too.
    few_at_height = "few_at_height"
    few_on_bark_at_height = "few_on_bark_at_height"
    rough_at_height = "rough_at_height"
    curvature_differs = "curvature_differs"
    uncertain_at_height = "uncertain_at_height"
    # Why a candidate is no stem, with how many there were.
    candidate_few_points = "candidate_few_points"
    candidate_no_ring = "candidate_no_ring"
    candidate_not_round = "candidate_not_round"
    candidate_radius = "candidate_radius"
    candidate_leans = "candidate_leans"
    candidate_short = "candidate_short"
    candidate_small_arc = "candidate_small_arc"
    candidate_rough_and_short = "candidate_rough_and_short"
    candidate_filled = "candidate_filled"
    candidate_flush = "candidate_flush"
    candidate_post = "candidate_post"
    # What was found, or why nothing was.
    trees_found = "trees_found"
    trees_corrected = "trees_corrected"
    none_in_photos = "none_in_photos"
    none_at_stem_height = "none_at_stem_height"
    none_holds = "none_holds"
    none_round = "none_round"
    nothing_measured = "nothing_measured"
    # Warnings of a plot.
    model_units = "model_units"
    not_finite = "not_finite"
    flagged = "flagged"
    frame_in_degrees = "frame_in_degrees"
    far_outside = "far_outside"
    coarse_steps = "coarse_steps"
    ground_in_part = "ground_in_part"
    little_ground = "little_ground"
    far_apart = "far_apart"
    lean_alike = "lean_alike"
    all_thick = "all_thick"
    thicker_upwards = "thicker_upwards"
    level_top = "level_top"
    cut_off_level = "cut_off_level"
    turned = "turned"
    thinned = "thinned"
    post_of_marker = "post_of_marker"
    shrubs_left_out = "shrubs_left_out"
    stumps_left_out = "stumps_left_out"
    thickets_left_out = "thickets_left_out"
    same_stem = "same_stem"
    forked = "forked"
    stems_outside_walk = "stems_outside_walk"
    part_joined = "part_joined"
    corrected_by_hand = "corrected_by_hand"
    edits_followed = "edits_followed"
    edits_left_out = "edits_left_out"
    sizes_unknown = "sizes_unknown"
    # Parts of ``corrected_by_hand``.
    tree_added = "tree_added"
    tree_deleted = "tree_deleted"
    tree_merged = "tree_merged"


#: What each code says; ``{name}`` is filled with the notice's values, ``{name:tree|trees}`` with a number and its noun.
SENTENCES: dict[StemCode, str] = {
    StemCode.no_scale: "no scale",
    StemCode.too_few_at_breast_height: "too few points at breast height: fewer than {least}",
    StemCode.too_few_on_bark: "too few points at breast height: {points}",
    StemCode.too_little_seen: "only {seen_deg:.0f} degrees of the stem are seen",
    StemCode.double_wall: "double wall: two surfaces {gap_cm:.1f} cm apart",
    StemCode.too_rough: "surface too rough: residual {residual_cm:.1f} cm",
    StemCode.too_uncertain: "too uncertain: {dbh_cm:.0f} cm +- {half_width_cm:.0f} cm",
    StemCode.not_round: (
        "no round surface at breast height: its curvature changes too much with the part that is looked at"
    ),
    StemCode.in_pieces: "what stands in the circle is {pieces} thin things with gaps between them, no single surface",
    StemCode.no_stem_here: "no stem to be measured is seen here",
    StemCode.ends_low: "it ends {top_m:.1f} m above the ground, below breast height",
    StemCode.edges_unsupported: (
        "edges alone are no measurement: {photos:photo has|photos have} some {edges_cm:.0f} cm apart, "
        "and no second pair of sides agrees on the size ({refused})"
    ),
    StemCode.edges_ragged: (
        "edges as ragged as those of leaves are no measurement: {photos:photo has|photos have} some {edges_cm:.0f} cm "
        "apart, and its points do not agree on the size ({refused})"
    ),
    StemCode.edges_unsure: (
        "the edges that {photos:photo has|photos have} some {edges_cm:.0f} cm apart hardly stand out or do not agree, "
        "and may be twigs ({refused})"
    ),
    StemCode.stands_across: (
        "what stands there below breast height is some {across_cm:.0f} cm across, and counts as so thick"
    ),
    StemCode.outside_walk: "outside of the walk: the nearest photo was taken {nearest_m:.0f} m away",
    StemCode.above_breast_height: "measured {off_cm:.0f} cm above breast height, corrected by its taper",
    StemCode.below_breast_height: "measured {off_cm:.0f} cm below breast height, corrected by its taper",
    StemCode.ground_unsure: "the ground at its foot is known to +- {std_cm:.0f} cm only",
    StemCode.little_seen: "only {seen_deg:.0f} degrees of the stem are seen",
    StemCode.wide_interval: "wide interval (+- {half_width_cm:.1f} cm)",
    StemCode.far_from_round: (
        "its section is farther from round than stems are: it grew so, or parts of the cloud do not fit"
    ),
    StemCode.blurred_points: "its points scatter by {residual_cm:.1f} cm about its surface",
    StemCode.rougher_than_others: (
        "residual {residual_cm:.1f} cm, far above the plot's other stems: perhaps a double wall"
    ),
    StemCode.forks_here: "it forks at breast height: a second stem, of {dbh_cm:.0f} cm, stands in it there",
    StemCode.top_seen: "its top is seen {top_m:.1f} m above the ground: a stump, a post, a person?",
    StemCode.hangs: "nothing of it is seen below {bottom_m:.1f} m, as if it hung there",
    StemCode.edges_alone: "only from its edges in {photos:photo|photos} ({refused})",
    StemCode.faint_edges: "mostly from its edges in {photos:photo|photos}, which agree on it only a little",
    StemCode.few_edges: "mostly from its edges in {photos:photo|photos}: few, or from few of its sides",
    StemCode.points_alone: "only from its points: no photo shows its edges clearly",
    StemCode.sources_disagree: "the points say {points_cm:.1f} cm, the edges in the photos {edges_cm:.1f} cm",
    StemCode.parts_disagree: "another part of the walk says {other_cm:.1f} cm",
    StemCode.boards_elsewhere: (
        "boards {boards} stand at two places each, up to {apart_m:.1f} m apart: unless two boards have each of these "
        "numbers, photos were placed wrongly, perhaps those that show this stem"
    ),
    StemCode.added_by_hand: "added by hand",
    StemCode.merged_by_hand: "{tree_id} and {other_id} merged by hand",
    StemCode.as_written: "{text}",
    StemCode.few_at_height: "too few points: {points}",
    StemCode.few_on_bark_at_height: "too few points on the bark: {points}",
    StemCode.rough_at_height: "surface too rough: residual {residual_cm:.1f} cm",
    StemCode.curvature_differs: "its curvature does not fit the stem next to it: a whorl, a fork, or twigs",
    StemCode.uncertain_at_height: "too uncertain: {diameter_cm:.0f} cm, standard deviation {std_cm:.0f} cm",
    StemCode.candidate_few_points: "{count} too few points",
    StemCode.candidate_no_ring: "{count} no ring",
    StemCode.candidate_not_round: "{count} not round",
    StemCode.candidate_radius: "{count} radius out of range",
    StemCode.candidate_leans: "{count} leans too much",
    StemCode.candidate_short: "{count} too short",
    StemCode.candidate_small_arc: "{count} arc too small",
    StemCode.candidate_rough_and_short: "{count} rough and short",
    StemCode.candidate_filled: "{count} filled inside",
    StemCode.candidate_flush: "{count} does not stand out",
    StemCode.candidate_post: "{count} post or board",
    StemCode.trees_found: "{trees:tree|trees} found, {measured} with a DBH",
    StemCode.trees_corrected: "{trees:tree|trees} after corrections by hand, {measured} with a DBH",
    StemCode.none_in_photos: "no trees found: what looked like stems in the cloud are none in the photos",
    StemCode.none_at_stem_height: (
        "no trees found: hardly a point lies {low_m}-{high_m} m above the ground (the cloud reaches {top_m:.2f} m)"
    ),
    StemCode.none_holds: "no trees found: {candidates:candidate|candidates}, none holds as a stem ({rejected})",
    StemCode.none_round: (
        "no trees found: {points:point|points} at stem height, but no round vertical surface among them"
    ),
    StemCode.nothing_measured: "no trees measured: {error}",
    StemCode.model_units: "no scale: positions are in model units and no diameter is given",
    StemCode.not_finite: (
        "{points:point with NaN or infinite coordinates was|points with NaN or infinite coordinates were} left out"
    ),
    StemCode.flagged: (
        "points that the file marks as withheld, or classes as noise (7 and 18), were left out: {points}"
    ),
    StemCode.frame_in_degrees: (
        "the header says degrees (EPSG:{epsg}), and the coordinates were taken as metres: maps and points get no frame"
    ),
    StemCode.far_outside: "{points:point far outside the plot was|points far outside the plot were} left out",
    StemCode.coarse_steps: ("the coordinates come in steps of {step_mm:.0f} mm: diameters cannot be better than that"),
    StemCode.ground_in_part: "ground seen in only {percent:.0f} % of the lowest parts of the plot",
    StemCode.little_ground: "little ground is seen: breast height is counted from the lowest points of the stems",
    StemCode.far_apart: (
        "the points at the height of the stems lie {spacing_cm:.1f} cm apart (median): stems may be missing, the "
        "thinner and those seen from one side first"
    ),
    StemCode.lean_alike: (
        "the stems lean the same way, {lean_deg:.0f} degrees in the mean of {stems}: either the stand does, or the "
        "cloud does not stand upright, and then heights, breast heights and slopes are wrong"
    ),
    StemCode.all_thick: (
        "half of the {stems} stems are thicker than {dbh_cm:.0f} cm, which few stands are: a cloud in feet has them "
        "3.28 times too thick"
    ),
    StemCode.level_top: (
        "the top of the cloud is more like a ground than its bottom, but its stems grow thinner upwards"
    ),
    StemCode.cut_off_level: (
        "the cloud ends level in the crowns of {stems} stems, as if it had been cut off there: their heights are not "
        "given"
    ),
    StemCode.thicker_upwards: "nearly all of the {stems} stems grow thicker upwards, as if z pointed down",
    StemCode.turned: "the cloud did not stand upright: {how} in it",
    StemCode.thinned: (
        "the cloud has {total:,} points: {kept:,} of them, drawn at random, were measured (up to {fine:.0f} in each "
        "cell of {cell_cm:.0f} cm between {low_m} and {high_m} m above the ground, {elsewhere:.0f} elsewhere)"
    ),
    StemCode.post_of_marker: ("an object at ({x_m:.1f}, {y_m:.1f}) was taken for the post of a marker, not for a tree"),
    StemCode.stumps_left_out: "left out as stumps or posts, which end below breast height: {places}",
    StemCode.thickets_left_out: (
        "left out as thickets: {count:circle|circles} of thin stems or shoots that stand apart, at {places}; "
        "add in edits.csv what is a tree among them"
    ),
    StemCode.shrubs_left_out: (
        "left out as shrubs, where the cloud has something like a stem and the photos show none: {places}"
    ),
    StemCode.same_stem: (
        "an entry at ({x_m:.1f}, {y_m:.1f}) stands in the stem at ({other_x_m:.1f}, {other_y_m:.1f}): it is the same"
    ),
    StemCode.forked: (
        "trees {tree_id} and {other_id} meet {height_m:.1f} m above the ground: they look like one tree that forks "
        "below breast height, which counts as two stems"
    ),
    StemCode.stems_outside_walk: (
        "stems outside of the walk ({stems}) are listed apart and not counted on the seen ground: {trees}; go nearer, "
        "or measure them with --far-stems"
    ),
    StemCode.part_joined: (
        "{folder} was put into the plot by the pattern of its stems: {common} that the rest saw too, "
        "{apart_cm:.0f} cm apart, and {new} new ones"
    ),
    StemCode.sizes_unknown: (
        "of the basal area {percent:.0f} % are taken to be that of stems without a diameter ({trees}), by a width or "
        "the mean section of the others; what is no tree among them makes the figures a hectare too large"
    ),
    StemCode.edits_followed: (
        "the trees of corrections by hand have other numbers on this map: {trees}; the corrections follow the trees"
    ),
    StemCode.edits_left_out: (
        "corrections by hand were left out (rows {rows}): they were written for another map, on which the trees of "
        "these numbers ({trees}) stood elsewhere; write the rows anew by this map, each with the place of its tree in "
        "x_m and y_m"
    ),
    StemCode.corrected_by_hand: "stem map corrected by hand: tree {changes}",
    StemCode.tree_added: "{tree_id} added",
    StemCode.tree_deleted: "{tree_id} deleted",
    StemCode.tree_merged: "{other_id} merged into {tree_id}",
}
#: What is said after it, behind a semicolon: the cause, or the way out.
ADVICE: dict[StemCode, str] = {
    StemCode.too_few_on_bark: "photograph the stem from more places",
    StemCode.too_little_seen: "walk round it",
    StemCode.double_wall: "the poses or scans do not agree at this stem, or it forks there",
    StemCode.forks_here: "measure the narrowest place below the fork by hand, or with --bh 1.0",
    StemCode.blurred_points: "check some of such stems with a tape",
    StemCode.too_rough: "undergrowth or bad depth at breast height",
    StemCode.too_uncertain: "walk round the stem",
    StemCode.edges_unsupported: "walk round it",
    StemCode.edges_ragged: "look at its strips of photographs, or check with a tape",
    StemCode.edges_unsure: "look at it, and walk round it if it is a tree",
    StemCode.faint_edges: "look at its strips of photographs, or check with a tape",
    StemCode.few_edges: "walk round it",
    StemCode.points_alone: "walk round it, nearer to it",
    StemCode.parts_disagree: "check with a tape",
    StemCode.boards_elsewhere: "take more photos on the way between them",
    StemCode.sources_disagree: "look at its strips of photographs, or check with a tape",
    StemCode.none_at_stem_height: "check the scale, or photograph the stems as well as the ground",
    StemCode.none_round: "check the scale",
    StemCode.lean_alike: "compare with a plumb line or with a stem that you know to be upright, and level the cloud",
    StemCode.all_thick: "compare one with a tape, and mend the scale: --scale 0.3048 for a cloud in feet",
    StemCode.far_apart: "give a cloud that was thinned less, or look round the plot from more places",
    StemCode.level_top: "it was left as it stands; look at it in a viewer if it was not cut off level",
    StemCode.cut_off_level: "for heights give the whole cloud; the diameters need only its lowest metres",
    StemCode.thicker_upwards: "look at the cloud in a viewer, and turn it if it stands on its head",
    StemCode.sizes_unknown: "look at them, measure them with a tape, or take them out with edits.csv",
    StemCode.turned: "it was turned, and so is the frame of all results",
}
#: Of use to those who look closely, nothing to act upon.
REMARKS: frozenset[StemCode] = frozenset(
    {
        StemCode.far_outside,
        StemCode.post_of_marker,
        StemCode.corrected_by_hand,
        StemCode.same_stem,
        StemCode.forked,
        StemCode.stems_outside_walk,
        StemCode.part_joined,
    }
)
#: The sentence says already that the stem has to be walked round again.
ADVISES_REVISIT: frozenset[StemCode] = frozenset(
    {
        StemCode.too_little_seen,
        StemCode.too_uncertain,
        StemCode.edges_unsupported,
        StemCode.edges_unsure,
        StemCode.few_edges,
        StemCode.points_alone,
    }
)
