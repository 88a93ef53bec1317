"""All settings of the dendrometry in one place."""

from __future__ import annotations

from dataclasses import dataclass, field

from fsinfer.conventions.breast_height import BREAST_HEIGHT_M, BhRule
from fsinfer.trees.common_lean import CommonLeanSettings
from fsinfer.trees.common_shape import CommonShapeSettings
from fsinfer.trees.diameter.dbh_settings import DbhSettings
from fsinfer.trees.diameter.roundness import RoundnessSettings
from fsinfer.trees.ground.settings import GroundSettings
from fsinfer.trees.height import TopSettings
from fsinfer.trees.sanity import SanitySettings
from fsinfer.trees.search.stem import StemSettings


@dataclass(frozen=True, kw_only=True)
class TreeSettings:
    """Settings of :func:`analyse_plot` and :func:`measure_trees`.

    Attributes
    ----------
    bh_m: breast height, metres, 0.3 to 3. Source: option; convention, 1.3 m; 1.37 m in the US.
    bh_rule: it counts from the ground at the stem's middle (``midpoint``) or from the highest ground at its
        foot (``uphill``), one of :class:`BhRule`. Source: option; forest inventories of many countries.
    min_dbh_cm: below lies undergrowth. Source: forest inventories start at 4 to 7 cm.
    seed: of all random draws. Source: numerics.
    ground, stems, dbh, sanity, lean, shape, roundness, top: of the steps.
    """

    bh_m: float = BREAST_HEIGHT_M
    bh_rule: str = BhRule.midpoint.value
    min_dbh_cm: float = 4.0
    seed: int = 0
    ground: GroundSettings = field(default_factory=GroundSettings)
    stems: StemSettings = field(default_factory=StemSettings)
    dbh: DbhSettings = field(default_factory=DbhSettings)
    sanity: SanitySettings = field(default_factory=SanitySettings)
    lean: CommonLeanSettings = field(default_factory=CommonLeanSettings)
    shape: CommonShapeSettings = field(default_factory=CommonShapeSettings)
    roundness: RoundnessSettings = field(default_factory=RoundnessSettings)
    top: TopSettings = field(default_factory=TopSettings)
