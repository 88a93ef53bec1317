"""Constants of the diameter at breast height, its interval and its refusals."""

from __future__ import annotations

from dataclasses import dataclass, field

from fsinfer.trees.diameter.slice import SliceSettings
from fsinfer.trees.diameter.spread import SpreadSettings


@dataclass(frozen=True, kw_only=True)
class DbhSettings:
    """Constants of :func:`measure_together`.

    Attributes
    ----------
    min_coverage: share of the circumference seen, below which the radius is left open. Source: chosen on simulated
        stems.
    doubtful_coverage: below it the diameter is doubtful. Source: chosen on simulated stems.
    max_sigma_m: noise of bark beyond which there is no diameter, unless the stem is seen all round. Source: chosen on
        simulated stems.
    blurred_sigma_m: the same of those that are; beyond ``max_sigma_m`` it is doubtful. The fit finds 3.5 cm where there
        are 4, and no more than 4.2 however many there are. Source: simulated stems (docs/trials-accuracy.md).
    blurred_coverage: share of the circumference seen of a stem that is seen all round. Source: as ``blurred_sigma_m``.
    even_noise_m: noise up to which its bias is that of noise in all directions; what is noisier is a scan, whose noise
        lies along the views mostly. Source: as ``blurred_sigma_m``.
    max_sigma_of_radius: the same as a share of the radius. Source: chosen on simulated stems.
    max_interval: width of a 95 % interval, share of the DBH, beyond which there is no diameter. Source: one stem of the
        rendered test plot and one simulated stem (docs/trees.md).
    doubtful_interval: the same, beyond which it is doubtful. Source: not recorded.
    doubtful_level_m: standard deviation of the ground's height at the foot beyond which it is doubtful. Source: twice
        that on relief which the ground follows (``python -m tests.bench.relief``).
    max_off_m: distance from breast height beyond which it is doubtful. Source: not recorded.
    outline_coverage: share of the circumference seen, from which girth, least and greatest diameter are given.
        Source: not recorded.
    local_std: how far a slice departs from the smooth taper by whorls and scars, share of the radius. Source: chosen on
        simulated stems, seeds 0-9.
    bark_std: a tape spans furrows that a smooth curve averages, share of the radius. Source: simulated walks, seeds
        43000-43029 (``walked-photo``) and 43000-43019 (``walked-lidar``), where bark has furrows; a tape on rendered
        bark reads 0.8 % more.
    hidden_std: what a stem may be off by the shape of sides that were not seen, share of the radius were none seen.
        Source: simulated walks, as ``bark_std``.
    common_share: where blocks of bark share more error than bark's own unevenness, the cause (edges fattened by a depth
        map, moss, poses) moves the whole circumference by so many times that, which no residual shows. Source: renders
        only, test plot (docs/trees.md).
    uneven_std: what blocks of bark differ by nature, share of the radius. Source: renders only, test plot.
    noise_share: noise is not quite a Gaussian with a tail, and it lies along the views; share of its standard
        deviation. Source: simulated walks, as ``bark_std``.
    stations_share: of how far the stations of a scanner, or passes of a walk, show a stem beside each other
        (:mod:`fsinfer.trees.diameter.file_order`). Source: simulated clouds of
        five stations and of walks (docs/trees.md); not blind to them.
    spread_factor: of the fit's own standard deviation. Source: simulated stems, seeds 0-9, 1000-1021 and 2000-2021.
    most_walls_m: how far apart two walls may be that are copies of the stem, a shift apart, of which the diameter is
        doubtful; beyond it, and of other walls, there is none. 0 for none of any. Source: judgement, the tears of
        simulated walks.
    walls_std: of such a diameter, share of their distance; of copies that are whole. Source: simulated walks, all torn.
    whole_walls: their distance, share of the DBH, up to which copies count as whole. Source: as ``walls_std``.
    taper_std: what the taper near breast height may differ from the fitted one, radius per metre. Source: not recorded.
    ground_std_m: where the ground is, between litter and mineral soil. Source: not recorded.
    max_change: share and metres by which the radius may differ from the search's. Source: chosen on simulated stems.
    half_windows_m: half of the piece of stem that is fitted; the next where the cloud is sparse. Source: chosen on
        simulated stems.
    slice, spread: of the steps.
    """

    min_coverage: float = 65.0 / 360.0
    doubtful_coverage: float = 100.0 / 360.0
    max_sigma_m: float = 0.026
    blurred_sigma_m: float = 0.037
    blurred_coverage: float = 0.8
    even_noise_m: float = 0.0175
    max_sigma_of_radius: float = 0.35
    max_interval: float = 0.6
    doubtful_interval: float = 0.22
    doubtful_level_m: float = 0.1
    max_off_m: float = 0.05
    outline_coverage: float = 0.8
    local_std: float = 0.0035
    bark_std: float = 0.005
    hidden_std: float = 0.042
    common_share: float = 1.5
    uneven_std: float = 0.006
    noise_share: float = 0.1
    stations_share: float = 0.5
    spread_factor: float = 1.15
    most_walls_m: float = 0.05
    walls_std: tuple[float, float] = (0.5, 0.15)
    whole_walls: float = 0.2
    taper_std: float = 0.002
    ground_std_m: float = 0.02
    max_change: tuple[float, float] = (0.35, 0.03)
    half_windows_m: tuple[float, ...] = (0.4, 0.6, 0.9)
    slice: SliceSettings = field(default_factory=SliceSettings)
    spread: SpreadSettings = field(default_factory=SpreadSettings)
