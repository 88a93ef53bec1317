"""Options that several commands share, and what they turn into."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fsinfer.conventions.breast_height import BREAST_HEIGHTS_M, BhRule
from fsinfer.depth.settings import DepthSettings, Precision
from fsinfer.frames.settings import Equalize, FrameSettings
from fsinfer.io.photo_size import PHOTO_SIZE_PX
from fsinfer.plot_border.request import BorderRequest, border_request
from fsinfer.scale.request import ScaleRequest, parse_point

if TYPE_CHECKING:
    from fsinfer.poses.settings import PoseSettings
    from fsinfer.trees import TreeSettings

_SCALE = "Scale (one of)"
_BORDER = "Border of the plot"
_WHERE = "Where depth is computed"

# What the settings have by default, as the options show it.
DEFAULT_EQUALIZE = Equalize(FrameSettings.equalize)
DEFAULT_PRECISION = Precision(DepthSettings.precision)
#: The reference among them. Source: option.
DEFAULT_VIEWS = DepthSettings.source_views + 1


def decimal(text: str) -> float:
    """Read a number; raises ``typer.BadParameter``, which tells who writes it with a comma how."""
    try:
        return float(text)
    except ValueError:
        comma = re.fullmatch(r"\s*[+-]?\d+,\d+\s*", text)
        hint = f"write a point, not a comma: {text.strip().replace(',', '.')}" if comma else "it is no number"
        msg = f"{text!r}: {hint}"
        raise typer.BadParameter(msg) from None


def decimal_within(least: float, most: float = math.inf) -> Callable[[str], float]:
    """What reads a number as :func:`decimal` does and refuses one below ``least``, above ``most``, or that is none."""

    def read(text: str) -> float:
        value = decimal(text)
        if not least <= value <= most:
            span = f"between {least:g} and {most:g}" if math.isfinite(most) else f"at least {least:g}"
            msg = f"{text}: it must be {span}"
            raise typer.BadParameter(msg)
        return value

    return read


Out = Annotated[Path, typer.Argument(help="Output folder; made if missing.", show_default=False)]
Threads = Annotated[int, typer.Option("--jobs", "-j", "--threads", min=0, help="Processor cores to use; 0 = all.")]
MemoryGb = Annotated[
    float,
    typer.Option(
        "--memory-gb",
        parser=decimal_within(0.5),
        help="Memory to stay within, in GB; less keeps less at hand.",
    ),
]
Provider = Annotated[
    str,
    typer.Option("--provider", help="Where depth is computed, with another build of onnxruntime: cuda, coreml ..."),
]


PrecisionHow = Annotated[
    Precision,
    typer.Option("--precision", help="Numbers of the depth network: int8 is faster on processors made for it."),
]

ScaleFactor = Annotated[
    float | None,
    typer.Option("--scale", parser=decimal, help="Metres per unit of the cloud.", rich_help_panel=_SCALE),
]
ArucoLength = Annotated[
    float | None,
    typer.Option(
        "--aruco-length-m",
        parser=decimal,
        help="Side of the black square of the ArUco markers in the photos, in metres, for example 0.25.",
        rich_help_panel=_SCALE,
    ),
]
ArucoDictionary = Annotated[
    str,
    typer.Option(
        "--aruco-dictionary",
        help="Which ArUco markers they are; run and check tie the photos by them, too.",
        rich_help_panel=_SCALE,
    ),
]
Endpoints = Annotated[
    tuple[str, str] | None,
    typer.Option(
        "--endpoints",
        metavar="X1,Y1,Z1 X2,Y2,Z2",
        help="Two points on something of known length, read off the cloud.ply of a run without a scale; "
        "needs --length-m.",
        rich_help_panel=_SCALE,
    ),
]
EndpointsLength = Annotated[
    float | None,
    typer.Option(
        "--length-m",
        parser=decimal,
        help="Distance between the two --endpoints, in metres.",
        rich_help_panel=_SCALE,
    ),
]


IntervalS = Annotated[
    float,
    typer.Option(
        "--interval-s",
        parser=decimal_within(0.05),
        help="Seconds of video between frames at most; less where you turn.",
    ),
]
EqualizeHow = Annotated[
    Equalize, typer.Option("--equalize", help="Even out brightness: not at all, locally (clahe), or the histogram.")
]

Model = Annotated[str, typer.Option("--model", help="Depth model: a name that comes with fsinfer, or a manifest file.")]
TrustModel = Annotated[
    bool, typer.Option("--trust-model", help="Use the model though its files are not those of its manifest.")
]
DepthScheduler = Annotated[
    str,
    typer.Option(
        "--scheduler",
        metavar="ADDRESS",
        help="Dask scheduler, like tcp://10.0.0.5:8786: its workers compute the depth maps. Needs fsinfer\\[cluster].",
        rich_help_panel=_WHERE,
        show_default=False,
    ),
]
DepthCopy = Annotated[
    bool,
    typer.Option(
        "--copy",
        help="Send the photos to the workers' own disks. Default: workers see them under the paths of this computer.",
        rich_help_panel=_WHERE,
    ),
]
Views = Annotated[
    int, typer.Option("--views", min=2, max=11, help="Photos compared at a time: one and its best neighbours.")
]
MaxSize = Annotated[
    int, typer.Option("--max-size", min=160, help="Longer side of the photos for depth, in pixels; smaller is faster.")
]
SizeForDepth = Annotated[
    int,
    typer.Option(
        "--max-size",
        min=160,
        help=f"The --max-size that depth will be given: photos are reduced to {PHOTO_SIZE_PX} pixels, or to so many "
        "where that is more.",
    ),
]
BreastHeight = Annotated[
    float,
    typer.Option(
        "--bh",
        parser=decimal_within(*BREAST_HEIGHTS_M),
        help="Breast height above the ground, in metres, 0.3 to 3 (US: 1.37).",
    ),
]


Edits = Annotated[
    Path | None,
    typer.Option(
        "--edits",
        help="CSV of corrections to the stem map: trees to delete, add or merge. Default: OUT/edits.csv.",
        show_default=False,
    ),
]
BreastHeightRule = Annotated[
    BhRule,
    typer.Option("--bh-rule", help="Count breast height from the ground in the middle of the stem, or uphill of it."),
]
FarStems = Annotated[
    bool,
    typer.Option(
        "--far-stems/--no-far-stems",
        help="Measure the stems outside of the walk too: those that no photo came near to.",
    ),
]


PlotRadius = Annotated[
    float | None,
    typer.Option(
        "--plot-radius-m",
        parser=decimal,
        help="Horizontal radius of a circular plot in metres, for example 12.62: figures a hectare are then of it.",
        rich_help_panel=_BORDER,
    ),
]
PlotCenter = Annotated[
    str | None,
    typer.Option(
        "--plot-center",
        metavar="marker:N | X,Y | walk",
        help="Centre of that circle: a board's number, a place in metres of the cloud, or the middle of your walk.",
        rich_help_panel=_BORDER,
    ),
]
PlotPolygon = Annotated[
    Path | None,
    typer.Option(
        "--plot-polygon",
        help="GeoJSON or CSV (x_m,y_m) with the corners of a plot of another shape, in metres of the cloud.",
        rich_help_panel=_BORDER,
        show_default=False,
    ),
]


def plot_border(radius_m: float | None, center: str | None, polygon: Path | None) -> BorderRequest:
    """Check the options of the border before any work begins; raises :class:`fsinfer.errors.InputError`."""
    return border_request(radius_m, center, polygon)


def scale_request(
    scale: float | None,
    aruco_length_m: float | None,
    aruco_dictionary: str,
    endpoints: tuple[str, str] | None,
    length_m: float | None,
) -> ScaleRequest:
    """Check the scale options before any work begins; raises :class:`fsinfer.errors.InputError`."""
    points = None if endpoints is None else (parse_point(endpoints[0]), parse_point(endpoints[1]))
    return ScaleRequest(
        factor=scale,
        aruco_length_m=aruco_length_m,
        aruco_dictionary=aruco_dictionary,
        endpoints=points,
        length_m=length_m,
    )


def pose_settings(scale: ScaleRequest, *, threads: int = 0, max_size: int = 0) -> PoseSettings:
    """Settings of the poses: markers tie the photos that tell the scale, so that both look for the same ones.

    ``check`` and ``run`` make them alike, and a run goes on with the poses of a check.
    """
    from fsinfer.poses.settings import PoseSettings

    return PoseSettings(threads=threads, dictionary=scale.aruco_dictionary, longest_px=max(PHOTO_SIZE_PX, max_size))


def frame_settings(*, interval_s: float, equalize: Equalize, max_size: int = 0) -> FrameSettings:
    """Settings of the choice of frames, which stay as large as depth is to be computed of."""
    return FrameSettings(interval_s=interval_s, equalize=equalize.value, longest_px=max(PHOTO_SIZE_PX, max_size))


def depth_settings(
    *,
    model: str,
    views: int,
    max_size: int,
    threads: int,
    memory_gb: float,
    provider: str,
    precision: Precision,
    trust_model: bool,
    scheduler: str,
    copy: bool,
) -> DepthSettings:
    """Settings of the depth stage; ``views`` counts the reference photograph too."""
    return DepthSettings(
        model=model,
        source_views=views - 1,
        max_size_px=max_size,
        threads=threads,
        memory_gb=memory_gb,
        provider=provider,
        precision=precision.value,
        trust_model=trust_model,
        scheduler=scheduler,
        copy_photos=copy,
    )


def tree_settings(*, bh_m: float, bh_rule: BhRule) -> TreeSettings:
    """Settings of the tree measurement."""
    from fsinfer.trees import TreeSettings

    return TreeSettings(bh_m=bh_m, bh_rule=bh_rule.value)
