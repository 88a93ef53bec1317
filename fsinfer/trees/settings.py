"""All settings of the dendrometry in one place."""

from __future__ import annotations

from dataclasses import dataclass, field

from fsinfer.trees.diameter.dbh import DbhSettings
from fsinfer.trees.ground.ground import GroundSettings
from fsinfer.trees.height import TopSettings
from fsinfer.trees.sanity import SanitySettings
from fsinfer.trees.search.stem import StemSettings


@dataclass(frozen=True, kw_only=True)
class TreeSettings:
    """Settings of :func:`analyse_plot` and :func:`measure_trees`.

    ``bh_rule``: breast height counts from the ground at the stem's middle ("midpoint") or from the highest ground at
    its foot ("uphill", as on forest inventories in many countries).
    """

    bh_m: float = 1.3
    bh_rule: str = "midpoint"
    min_dbh_cm: float = 4.0  # below lies undergrowth; forest inventories start at 4 to 7 cm
    seed: int = 0
    ground: GroundSettings = field(default_factory=GroundSettings)
    stems: StemSettings = field(default_factory=StemSettings)
    dbh: DbhSettings = field(default_factory=DbhSettings)
    sanity: SanitySettings = field(default_factory=SanitySettings)
    top: TopSettings = field(default_factory=TopSettings)
