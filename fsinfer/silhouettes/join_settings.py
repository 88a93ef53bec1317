"""What the joining of a cloud's diameters with those of the photographs' edges assumes."""

from __future__ import annotations

from dataclasses import dataclass, field

from fsinfer.silhouettes.combine import CombineSettings
from fsinfer.silhouettes.edge_settings import EdgeSettings
from fsinfer.silhouettes.one_look import LookSettings
from fsinfer.silhouettes.support import SupportSettings
from fsinfer.silhouettes.wide_look import WideLookSettings
from fsinfer.trees.diameter.silhouette_settings import SilhouetteSettings


@dataclass(frozen=True, kw_only=True)
class SilhouetteJoinSettings:
    """Constants of the joining. "Three renders" are the open, the sloped and the test plot.

    Attributes
    ----------
    cloud_floor_m: added to the error of the cloud's radius: depth maps fatten edges. Source: renders only, three
        renders.
    points_alone_factor: points whose stem's edges no photograph shows are off by so many times what they say. Source:
        renders only, 22 stems in and round seven plots photographed by a phone (seeds 954001, 955001 to 955006): 2.24
        times, 15 of them inside their intervals, RMSE 5.2 cm; those with edges there 1.0 times.
    haze_m: scatter of the points beyond which they lie in a haze. Source: judgement, bark seen from near scatters by 1
        to 4 mm on renders, and what the depth maps have of a stem seen from far by 5 to 30.
    hazy_one_sided, clear_contrast: what sides unseen leave open in the edges' radius is so many times as much where the
        points lie in a haze and the edges have less contrast. Source: renders only, stretches and wholes of two plots
        photographed by a phone (seeds 955055 and 955057), afterwards: of five such stems seen from under 0.45 of their
        sides four were 1.9 to 3.4 standard deviations off, of 28 others none more than 1.3
        (docs/trials-accuracy.md).
    sure_photos: fewer, and a stem that the cloud could not measure, or has as a haze, stays doubtful. Source: renders
        only, three renders.
    sure_sectors: the same for the directions that they cover. Source: renders only, three renders.
    shrub_photos: so many photographs show the place, and ... Source: renders only, two undergrown plots (seeds 700013
        and 955023), afterwards: a shrub had 14.
    shrub_contrast: ... their edges agree no better than this on a stem: a shrub. Source: renders only, undergrown plot,
        afterwards: 1.02 to 1.07, a half-hidden stem 1.18.
    sizeless_contrast: the same where the points leave the diameter open by more than itself. Source: renders only, a
        shrub of the undergrown plot of seed 955022, afterwards: 23 cm +- 53 cm, 1.16 in 25 photographs; stems that come
        out right have 1.2 and more (:class:`fsinfer.trees.diameter.silhouette_settings.SilhouetteSettings`).
    all_round, all_round_contrast: what shows so much of its girth and has no diameter by its points, and whose edges
        agree no better and have nothing beside them of the same size, is a shrub. Source: renders only, one of the
        undergrown plot of seed 955027, afterwards: 11 cm +- 4 cm, 0.76 of its girth, 1.20 in 18 photographs; the
        contrast is what one of a pair of sides needs.
    large_px: only photographs count for that which show its radius so large, pixels. Source: renders only, that shrub
        has twelve of them; a stem of 9 cm of the plot of seed 955028, afterwards, 1.15 in 17 photographs, has two, and
        was left out as a shrub.
    many_photos: so many photographs show the place, ... Source: renders only, a shrub of the undergrown plot of seed
        955023, afterwards, in 55 photographs.
    large_photos: ... or so many show it large, ... Source: renders only, a shrub of the undergrown plot of seed 955027,
        afterwards, 1.15 in eight; no stem within five plots has less than 1.25.
    many_contrast: ... and their edges agree no better: what so many do not know is no stem. Source: as before, 1.14; a
        half-hidden stem 1.18.
    edges, looks, wider, fit, support, combine: of the steps.
    """

    cloud_floor_m: float = 0.0015
    points_alone_factor: float = 2.25
    haze_m: float = 0.005
    hazy_one_sided: float = 2.0
    clear_contrast: float = 1.6
    sure_photos: int = 8
    sure_sectors: float = 0.3
    shrub_photos: int = 12
    shrub_contrast: float = 1.12
    sizeless_contrast: float = 1.2
    all_round: float = 0.6
    all_round_contrast: float = 1.3
    large_px: float = 6.0
    many_photos: int = 40
    large_photos: int = 8
    many_contrast: float = 1.16
    edges: EdgeSettings = field(default_factory=EdgeSettings)
    looks: LookSettings = field(default_factory=LookSettings)
    wider: WideLookSettings = field(default_factory=WideLookSettings)
    fit: SilhouetteSettings = field(default_factory=SilhouetteSettings)
    support: SupportSettings = field(default_factory=SupportSettings)
    combine: CombineSettings = field(default_factory=CombineSettings)
