"""The settings of every stage of a run."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from fsinfer.depth.settings import DepthSettings
from fsinfer.depth.sfm_check import SfmCheckSettings
from fsinfer.frames.select import FrameSettings
from fsinfer.fusion.fuse import FusionSettings
from fsinfer.output.json_values import as_json
from fsinfer.placement.settings import LevelSettings
from fsinfer.plot_border.request import BorderRequest
from fsinfer.poses.settings import PoseSettings
from fsinfer.scale.request import ScaleRequest
from fsinfer.scale.square_fit import MarkerSettings
from fsinfer.silhouettes.join_settings import SilhouetteJoinSettings
from fsinfer.silhouettes.tops import TopViewSettings
from fsinfer.silhouettes.walk import WalkSettings
from fsinfer.trees import TreeSettings
from fsinfer.trees.pattern.match import PatternSettings
from fsinfer.trees.stem_curve import CurveSettings

# How the work is spread over the machine does not change what comes out. The precision asked for and the trust in a
# model may, but the hash of the graphs that they led to on this machine says so better.
_SPEED_OPTIONS = frozenset({"threads", "memory_gb", "provider", "precision", "trust_model", "scheduler", "copy_photos"})


@dataclass(frozen=True, kw_only=True)
class RunSettings:
    """The settings of every stage; the defaults suit a plot photographed with a phone.

    A stage's settings are part of its fingerprint in the ledger, so that a setting which stands nowhere here would be
    one that changes results unnoticed.
    """

    frames: FrameSettings = field(default_factory=FrameSettings)
    poses: PoseSettings = field(default_factory=PoseSettings)
    depth: DepthSettings = field(default_factory=DepthSettings)
    sfm_check: SfmCheckSettings = field(default_factory=SfmCheckSettings)
    fusion: FusionSettings = field(default_factory=FusionSettings)
    scale: ScaleRequest = field(default_factory=ScaleRequest)
    markers: MarkerSettings = field(default_factory=MarkerSettings)
    level: LevelSettings = field(default_factory=LevelSettings)
    trees: TreeSettings = field(default_factory=TreeSettings)
    silhouettes: SilhouetteJoinSettings = field(default_factory=SilhouetteJoinSettings)
    stem_curve: CurveSettings = field(default_factory=CurveSettings)
    border: BorderRequest = field(default_factory=BorderRequest)
    walk: WalkSettings = field(default_factory=WalkSettings)
    tops: TopViewSettings = field(default_factory=TopViewSettings)
    pattern: PatternSettings = field(default_factory=PatternSettings)


def speedless(settings: Any) -> dict[str, Any]:
    """Settings as JSON values, without those that say how the work is spread over the machine."""
    return {key: value for key, value in as_json(settings).items() if key not in _SPEED_OPTIONS}
