"""The manifest beside the ONNX files: what they are, how they fit together, and the hash that proves it."""

from __future__ import annotations

import hashlib
import logging
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsinfer.depth.photo_confidence import QUANTITIES, ConfidenceCurves
from fsinfer.depth.surface import SURFACE
from fsinfer.errors import ModelError
from fsinfer.io.json_text import read_json

_log = logging.getLogger(__name__)

#: Channels of the feature maps at a quarter and at half resolution, where a manifest does not tell. Source: format;
#: those of the model that is shipped.
_FEATURE_CHANNELS, _REFINE_CHANNELS = 16, 8
#: Pixels of the image to one of the volume, where a manifest does not tell. Source: format; the features' own.
_QUARTER = 4
#: Channels of the first level of a 3D regularizer, where a manifest does not tell. Source: format; MVSNet.
_LEVEL_CHANNELS = 8

# Numbers of a manifest that count something.
_COUNTS = (
    "packed_planes",
    "wide_stride",
    "planes",
    "groups",
    "level_channels",
    "feature_channels",
    "refine_channels",
    "refine_planes",
    "refine_looked_up",
)
#: More than any model has of any of them. Source: judgement; memory goes with their product.
_MOST = 4096


@dataclass(frozen=True, kw_only=True)
class Candidates:
    """Between a volume at an eighth of the resolution and what is refined, see :mod:`fsinfer.depth.candidates`.

    Attributes
    ----------
    graph: ONNX file; int8_graph: the same in 8-bit integers, or ``None``.
    around, step: candidates round each of a pixel's three indices, and how far they lie apart, planes.
    looked_up: of each as many, evenly from the first to the last, are compared; the graph has what lies between them.
    """

    graph: str
    int8_graph: str | None
    around: int
    step: float
    looked_up: int

    @property
    def looked_up_step(self) -> float:
        """How far those that are looked up lie apart, planes."""
        return self.step * (self.around - 1) / max(1, self.looked_up - 1)


@dataclass(frozen=True, kw_only=True)
class TileGraph:
    """The regularizer for parts of a volume.

    Attributes
    ----------
    regularizer: ONNX file.
    halo: how far its result sees, pixels of the volume, rounded up to ``align``; level_halos: the same of its levels,
        whose means over the whole it is given.
    volume_mean: whether it is given the mean of each channel over the whole volume.
    align: parts begin at multiples of so many pixels of the volume.
    """

    regularizer: str
    halo: int
    level_halos: tuple[int, ...]
    volume_mean: bool
    align: int


@dataclass(frozen=True, kw_only=True)
class ModelManifest:
    """A depth model made of ONNX graphs.

    Attributes
    ----------
    name: of the preset. folder: where the files lie.
    features, regularizer: ONNX file names; refiner: the same, or ``None``.
    volume: ``correlation`` or ``variance``; packed_planes: planes of a slab
        that the regularizer takes as channels; 0 where it takes the whole volume.
    wide_stride: pixels of the image to one of the volume: 4, or 8, of which ``candidates`` come between.
    planes: number of planes of the volume (192); inverse_depth: uniform in 1/depth.
    groups: values of the volume at each plane and pixel: groups of the correlation, or channels of the variance.
    level_channels: channels of the first level of a regularizer that takes the whole volume; 0 where it takes slabs.
    feature_channels: of a feature map at a quarter; refine_channels: at half resolution, 0 where nothing is refined.
    refine_planes, refine_span: the narrow volume at half resolution; span in plane intervals on each side.
    refine_looked_up: of its hypotheses so many, evenly from the first to the last, are compared; the graph has what
        lies between them.
    surface: the graph of :mod:`fsinfer.depth.surface`, in float32 in both precisions; ``None`` where there is none.
    sha256: over the graphs' bytes, in the order features, regularizer, candidates, refiner, surface.
    int8_regularizer, int8_features, int8_refiner: the graphs in 8-bit integers, and ``int8_sha256`` the hash with them
        in place of the others; ``None`` where the model has none. One with an int8 regularizer may lack the others.
    tiles: the float32 regularizer for parts of a volume, ``None`` where the model cannot be cut into tiles.
    parity_confidence_threshold: at which the check of the export compares the confidence masks; fusion finds its own
        threshold for each plot.
    calibration: raw confidences and the share of pixels within 1 % of the true depth at each of them, both rising;
        ``None`` where the model was not calibrated.
    photo_confidence: curves of :mod:`fsinfer.depth.photo_confidence`; ``None`` where the network's word is all.
    """

    name: str
    folder: Path
    features: str
    regularizer: str
    refiner: str | None
    surface: str | None
    volume: str
    packed_planes: int
    wide_stride: int
    candidates: Candidates | None
    planes: int
    groups: int
    level_channels: int
    feature_channels: int
    refine_channels: int
    inverse_depth: bool
    refine_planes: int
    refine_looked_up: int
    refine_span: float
    sha256: str
    int8_regularizer: str | None
    int8_features: str | None
    int8_refiner: str | None
    int8_sha256: str | None
    tiles: TileGraph | None
    parity_confidence_threshold: float
    calibration: tuple[NDArray[np.float32], NDArray[np.float32]] | None
    photo_confidence: ConfidenceCurves | None
    details: dict[str, Any]

    @property
    def files(self) -> list[Path]:
        """Paths of the float32 graphs, in the order of the hash."""
        return self.files_of(int8=False)

    def files_of(self, *, int8: bool) -> list[Path]:
        """Paths of the graphs of that precision, in the order of the hash; in float32 where there is none in int8."""
        return list(self.graphs_of(int8=int8).values())

    def graphs_of(self, *, int8: bool) -> dict[str, Path]:
        """The same by their roles."""
        chooser = self.candidates
        names = {
            "features": (self.features, self.int8_features),
            "regularizer": (self.regularizer, self.int8_regularizer),
            "candidates": (None, None) if chooser is None else (chooser.graph, chooser.int8_graph),
            "refiner": (self.refiner, self.int8_refiner),
            SURFACE: (self.surface, None),
        }
        return {
            role: self.folder / (quick if int8 and quick else exact)
            for role, (exact, quick) in names.items()
            if exact is not None
        }

    def sha256_of(self, *, int8: bool) -> str:
        """SHA-256 over the bytes of :meth:`files_of`, which tells results of the two precisions apart."""
        return self.int8_sha256 if int8 and self.int8_sha256 is not None else self.sha256


def hash_files(paths: list[Path]) -> str:
    """SHA-256 over the bytes of the files, one after the other."""
    digest = hashlib.sha256()
    for path in paths:
        digest.update(path.read_bytes())
    return digest.hexdigest()


def models_folder() -> Path:
    """The folder of the shipped models: inside the installed package, or ``models/`` of a source checkout."""
    package = Path(__file__).parents[1]
    inside = package / "models"
    return inside if inside.is_dir() else package.parent / "models"


def read_manifest(name_or_path: str | Path, *, trust: bool = False) -> ModelManifest:
    """Find and check a model by its name (``field``) or the path of its manifest (``.json``).

    With ``trust`` graphs whose hash is not the manifest's are taken all the same, with a warning in the log; the hashes
    of the manifest that is returned are those of the graphs.

    Raises
    ------
    ModelError
        No such model, a graph is missing or cut short, or the hash differs from the manifest's.
    """
    path = Path(name_or_path)
    if path.suffix != ".json":
        path = path / "manifest.json" if path.is_dir() else models_folder() / f"{name_or_path}.json"
    if not path.is_file():
        known = ", ".join(sorted(p.stem for p in models_folder().glob("*.json")))
        msg = f"no depth model {name_or_path!s}: {path} does not exist; models that came with fsinfer: {known}"
        raise ModelError(msg)
    try:
        data = read_json(path)
        manifest = ModelManifest(
            name=data["name"],
            folder=path.parent,
            features=data["graphs"]["features"]["file"],
            regularizer=data["graphs"]["regularizer"]["file"],
            refiner=data["graphs"]["refiner"]["file"] if "refiner" in data["graphs"] else None,
            surface=data[SURFACE]["file"] if SURFACE in data else None,
            volume=data["volume"]["kind"],
            packed_planes=data["volume"]["packed_planes"],
            wide_stride=data["volume"].get("stride", _QUARTER),
            candidates=_candidates(data),
            planes=data["volume"]["planes"],
            groups=_groups(data),
            level_channels=0 if data["volume"]["packed_planes"] else _config(data, "width", _LEVEL_CHANNELS),
            feature_channels=_config(data, "feature_channels", _FEATURE_CHANNELS),
            refine_channels=_config(data, "refine_channels", _REFINE_CHANNELS) if "refiner" in data["graphs"] else 0,
            inverse_depth=data["volume"]["inverse_depth"],
            refine_planes=data["refine"]["planes"],
            refine_looked_up=data["refine"].get("looked_up", data["refine"]["planes"]),
            refine_span=data["refine"]["span"],
            sha256=data["sha256"],
            int8_regularizer=data["int8"]["regularizer"] if "int8" in data else None,
            int8_features=data["int8"].get("features") if "int8" in data else None,
            int8_refiner=data["int8"].get("refiner") if "int8" in data else None,
            int8_sha256=data["int8"]["sha256"] if "int8" in data else None,
            tiles=_tiles(data.get("tiles")),
            parity_confidence_threshold=_either(data, "parity_confidence_threshold", "confidence_threshold"),
            calibration=_calibration(data.get("confidence_calibration")),
            photo_confidence=_curves(data.get("photo_confidence")),
            details=data,
        )
        _check(manifest, data)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
        msg = f"{path} is not a model manifest ({type(error).__name__}: {error}); install fsinfer again or re-export"
        raise ModelError(msg) from error
    precisions = (False, True) if manifest.int8_regularizer is not None else (False,)
    found = [
        _check_files(manifest, manifest.files_of(int8=int8), manifest.sha256_of(int8=int8), trust=trust)
        for int8 in precisions
    ]
    if manifest.tiles is not None:
        _check_files(manifest, [manifest.folder / manifest.tiles.regularizer], data["tiles"]["sha256"], trust=trust)
    return replace(manifest, sha256=found[0], int8_sha256=found[1] if len(found) > 1 else manifest.int8_sha256)


def _check(manifest: ModelManifest, data: dict[str, Any]) -> None:
    """Raise ValueError or KeyError where an entry has another type or size than any model has."""
    files: list[Any] = [manifest.features, manifest.regularizer]
    of_int8 = (manifest.int8_features, manifest.int8_regularizer, manifest.int8_refiner)
    files += [file for file in (manifest.refiner, manifest.surface, *of_int8) if file is not None]
    if manifest.surface is not None and manifest.refiner is None:
        msg = f"{SURFACE} goes with a refiner"
        raise ValueError(msg)
    chooser = manifest.candidates
    if (manifest.wide_stride, chooser is None) not in ((_QUARTER, True), (2 * _QUARTER, False)):
        msg = f"stride is {manifest.wide_stride!r}, with {'no ' if chooser is None else ''}candidates"
        raise ValueError(msg)
    if chooser is not None:
        files += [file for file in (chooser.graph, chooser.int8_graph) if file is not None]
        if not 1 <= chooser.around <= _MOST or not 0 < chooser.step <= _MOST or manifest.volume != "correlation":
            msg = f"candidates are {chooser.around} around, {chooser.step} apart, of a volume of {manifest.volume}"
            raise ValueError(msg)
        if not min(2, chooser.around) <= chooser.looked_up <= chooser.around:
            msg = f"of {chooser.around} candidates {chooser.looked_up} are looked up"
            raise ValueError(msg)
    hashes: list[Any] = [manifest.sha256]
    if manifest.int8_regularizer is not None:
        hashes.append(manifest.int8_sha256)
    if manifest.tiles is not None:
        files.append(manifest.tiles.regularizer)
        hashes.append(data["tiles"]["sha256"])
    for file in files:
        # A manifest of somebody else names graphs beside it, and nothing elsewhere.
        if not isinstance(file, str) or file in ("", "..") or set(file) & set("/\\:\0"):
            msg = f"{file!r} is no name of a file beside it"
            raise ValueError(msg)
    for sha256 in hashes:
        if not isinstance(sha256, str):
            msg = f"{sha256!r} is no hash"
            raise ValueError(msg)
    for name in _COUNTS:
        value = getattr(manifest, name)
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= _MOST:
            msg = f"{name} is {value!r}"
            raise ValueError(msg)
    if manifest.packed_planes and manifest.planes % manifest.packed_planes:
        msg = f"{manifest.planes} planes are no whole number of slabs of {manifest.packed_planes}"
        raise ValueError(msg)
    if manifest.refiner is not None and not 2 <= manifest.refine_looked_up <= manifest.refine_planes:
        msg = f"refine_planes is {manifest.refine_planes}, {manifest.refine_looked_up} of them looked up"
        raise ValueError(msg)
    span: Any = manifest.refine_span
    if manifest.planes < 2 or isinstance(span, bool) or not isinstance(span, (int, float)) or not 0 <= span <= _MOST:
        msg = f"planes are {manifest.planes}, refine_span is {span!r}"
        raise ValueError(msg)


def _check_files(manifest: ModelManifest, files: list[Path], sha256: str, *, trust: bool) -> str:
    """The hash of the files, which is ``sha256`` unless it is trusted."""
    missing = [file.name for file in files if not file.is_file()]
    if missing:
        where = f"missing in {manifest.folder}"
        msg = f"model {manifest.name}: {missing} {where}; install fsinfer again or re-export the model"
        raise ModelError(msg)
    try:
        found = hash_files(files)
    except OSError as error:
        msg = f"model {manifest.name} in {manifest.folder} cannot be read ({error}); install fsinfer again"
        raise ModelError(msg) from error
    if found == sha256:
        return found
    what = f"model {manifest.name} in {manifest.folder} is damaged or was changed: SHA-256 {found[:12]}…"
    if not trust:
        msg = f"{what}, manifest {sha256[:12]}…; install fsinfer again, re-export the model, or give --trust-model"
        raise ModelError(msg)
    _log.warning("%s; it is used all the same", what)
    return found


def _config(data: dict[str, Any], name: str, default: int) -> int:
    """A number of the network, where the manifest tells it."""
    return int(data.get("config", {}).get(name, default))


def _either(data: dict[str, Any], name: str, former: str) -> Any:
    """An entry that manifests of fsinfer 0.1 hold under another name."""
    return data[name] if name in data else data[former]


def _groups(data: dict[str, Any]) -> int:
    volume = data["volume"]
    if "channels" in volume:
        return int(volume["channels"])
    # fsinfer 0.1 wrote the groups of the correlation, whatever the kind of the volume.
    return int(volume["groups"] if volume["kind"] == "correlation" else data["config"]["feature_channels"])


def _candidates(data: dict[str, Any]) -> Candidates | None:
    if "candidates" not in data["graphs"]:
        return None
    return Candidates(
        graph=data["graphs"]["candidates"]["file"],
        int8_graph=data.get("int8", {}).get("candidates"),
        around=int(data["candidates"]["around"]),
        step=float(data["candidates"]["step"]),
        looked_up=int(data["candidates"].get("looked_up", data["candidates"]["around"])),
    )


def _tiles(entry: dict[str, Any] | None) -> TileGraph | None:
    if entry is None:
        return None
    return TileGraph(
        regularizer=entry["regularizer"],
        halo=int(entry["halo"]),
        level_halos=tuple(int(halo) for halo in entry["level_halos"]),
        volume_mean=bool(entry.get("volume_mean", False)),
        align=int(entry["align"]),
    )


def _calibration(entry: dict[str, list[float]] | None) -> tuple[NDArray[np.float32], NDArray[np.float32]] | None:
    if entry is None:
        return None
    raw, share = np.array(entry["raw"], np.float32), np.array(entry["within_1pct"], np.float32)
    if raw.shape != share.shape or raw.ndim != 1 or len(raw) < 2 or not (np.diff(raw) > 0).all():
        msg = f"confidence_calibration needs two equally long rising lists, has {raw.shape=}, {share.shape=}"
        raise ValueError(msg)
    return raw, share


def _curves(entry: dict[str, Any] | None) -> ConfidenceCurves | None:
    if entry is None:
        return None
    places, values = ({name: np.array(entry[name][key], np.float32) for name in QUANTITIES} for key in ("at", "adds"))
    for name in QUANTITIES:
        at, adds = places[name], values[name]
        finite = np.isfinite(np.r_[at.ravel(), adds.ravel()]).all()
        if at.shape != adds.shape or at.ndim != 1 or len(at) < 2 or not (finite and (np.diff(at) > 0).all()):
            msg = f"photo_confidence needs two equally long lists of numbers of {name}, the first rising"
            raise ValueError(msg)
    return ConfidenceCurves(places=places, values=values, constant=float(entry["constant"]))
