"""The breakages that a review found unnoticed: each by one place, in one or more ways, all of which must be noticed.

A number is broken by half and by double of it: a term of the interval whose size no test knows is as good as none.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tests.mutation.mutants import Mutant
from tests.support.places import ROOT

_CONSISTENCY = ("tests/fsinfer/fusion/test_consistency.py",)
_SCALE = ("tests/fsinfer/scale/test_scale_interval.py",)
_LOSSES = ("tests/training/test_losses.py", "tests/training/test_model.py::test_the_hybrid_loss_is_that_of_the_paper")
_DBH = "fsinfer/trees/diameter/dbh.py"
_DBH_SETTINGS = "fsinfer/trees/diameter/dbh_settings.py"


def _interval(test: str) -> tuple[str, ...]:
    return (f"tests/fsinfer/trees/diameter/test_interval.py::{test}",)


def _model(test: str) -> tuple[str, ...]:
    return (f"tests/training/test_model.py::{test}",)


@dataclass(frozen=True, kw_only=True)
class Named:
    """``before`` stands once in ``file``; put in its place, each of ``after`` has to be seen by one of ``tests``."""

    file: str
    before: str
    after: tuple[str, ...]
    tests: tuple[str, ...]


def _halved_and_doubled(file: str, name: str, value: float, tests: tuple[str, ...]) -> Named:
    text = f"    {name}: float = {value}\n"
    other = tuple(f"    {name}: float = {times * value!r}\n" for times in (0.5, 2.0))
    return Named(file=file, before=text, after=other, tests=tests)


NAMED: dict[str, Named] = {
    "reprojection error ignored in the consistency check": Named(
        file="fsinfer/fusion/consistency.py",
        before="np.ceil(np.maximum(error, np.abs(bz - depth) / (depth * step)))",
        after=("np.ceil(np.abs(bz - depth) / (depth * step))",),
        tests=_CONSISTENCY,
    ),
    "seen-through veto": Named(
        file="fsinfer/fusion/fuse.py",
        before="(passed <= LEVELS) & ~((through >= settings.min_seen_through) & (through > agreeing))",
        after=("(passed <= LEVELS)", "(passed <= LEVELS) & ~(through >= settings.min_seen_through)"),
        tests=_CONSISTENCY,
    ),
    "voxel merge weight": Named(
        file="fsinfer/fusion/voxels.py",
        before="weight, count = samples.weight, samples.count",
        after=("weight, count = np.ones(len(samples)), samples.count",),
        tests=("tests/fsinfer/fusion/test_voxels.py",),
    ),
    "depth resume key without poses": Named(
        file="fsinfer/workflow/cloud_stages.py",
        before='            "scene": scene_digest(scene),\n',
        after=("", '            "scene": [view.name for view in scene.views],\n'),
        tests=("tests/fsinfer/workflow/test_cloud_stages.py",),
    ),
    "depth resume key without poses, in the digest of a scene": Named(
        file="fsinfer/scene.py",
        before="camera.intrinsic.tobytes() + camera.cam_from_world.tobytes()",
        after=("camera.intrinsic.tobytes()", "camera.cam_from_world.tobytes()"),
        tests=("tests/fsinfer/io/test_pfm_and_scene.py::test_the_digest_of_a_scene_sees_all_that_depth_hangs_on",),
    ),
    "grazing-ray correction": Named(
        file="fsinfer/silhouettes/edges.py",
        before="support = strip.distance_m * np.abs(place) / slant",
        after=("support = np.abs(place)",),
        tests=("tests/fsinfer/silhouettes/test_edges.py",),
    ),
    "girth factor": Named(
        file=_DBH,
        before="    girth = _girth_factor(fit, spread)\n",
        after=(
            "    girth = 1.0\n",
            "    girth = 0.5 * (1.0 + _girth_factor(fit, spread))\n",
            "    girth = _girth_factor(fit, spread) ** 2\n",
        ),
        tests=_interval("test_an_oval_stem_has_more_girth_than_the_circle_of_its_mean_radius"),
    ),
    "1.5 cm residual bound": _halved_and_doubled(
        "fsinfer/trees/diameter/circle.py", "drop_residual_m", 0.015, ("tests/fsinfer/trees/diameter/test_circle.py",)
    ),
    "taper prior": Named(
        file="fsinfer/trees/cylinder/axis.py",
        before="s.lean_std**-2, s.taper_std**-2\n",
        after=(
            "s.lean_std**-2, 0.0\n",
            "s.lean_std**-2, (0.5 * s.taper_std) ** -2\n",
            "s.lean_std**-2, (2 * s.taper_std) ** -2\n",
        ),
        tests=_interval("test_a_radius_above_a_narrow_ring_is_as_unsure_as_the_taper_of_stems"),
    ),
    "common_share": _halved_and_doubled(
        _DBH_SETTINGS, "common_share", 1.5, _interval("test_what_fattens_blocks_of_bark_fattens_the_whole")
    ),
    "spread_factor": _halved_and_doubled(
        _DBH_SETTINGS, "spread_factor", 1.15, _interval("test_the_fit_of_stems_as_unround_as_its_priors_say")
    ),
    "bark_std": _halved_and_doubled(_DBH_SETTINGS, "bark_std", 0.005, _interval("test_a_tape_over_ridges_of_bark")),
    "common_px": _halved_and_doubled(
        "fsinfer/trees/diameter/silhouette_settings.py",
        "common_px",
        0.08,
        ("tests/fsinfer/silhouettes/test_join.py::test_edges_that_all_err_alike_are_in_the_error_of_the_fit",),
    ),
    "scale term": Named(
        file=_DBH,
        before='"scale": radius * scale_rel_std,',
        after=('"scale": 0.5 * radius * scale_rel_std,', '"scale": 2.0 * radius * scale_rel_std,', '"scale": 0.0,'),
        tests=_interval("test_a_cloud_of_the_wrong_size"),
    ),
    "marker blooming": _halved_and_doubled("fsinfer/scale/square_fit.py", "edge_std_px", 0.07, _SCALE),
    "board length": _halved_and_doubled("fsinfer/scale/square_fit.py", "length_rel_std", 0.002, _SCALE),
    "SE r": Named(
        file="training/model/attention.py",
        before="\nREDUCTION = 16\n",
        after=("\nREDUCTION = 8\n", "\nREDUCTION = 32\n"),
        tests=_model("test_squeeze_excitation_reduces_by_16_down_to_its_floor"),
    ),
    "multi-scale weight 0.5": Named(
        file="training/model/config.py",
        before="lambda_multiscale: float = 0.5 ",
        after=("lambda_multiscale: float = 0.25 ", "lambda_multiscale: float = 1.0 "),
        tests=_LOSSES,
    ),
    "order of w_s": Named(
        file="training/losses.py",
        before='return weights if first_scale == "coarsest" else weights[::-1]',
        after=('return weights if first_scale == "finest" else weights[::-1]', "return [1.0] * count"),
        tests=_LOSSES,
    ),
    "attention term": Named(
        file="training/losses.py",
        before=" + config.lambda_attention * attention\n",
        after=("\n", " - config.lambda_attention * attention\n", " + 0.5 * config.lambda_attention * attention\n"),
        tests=_LOSSES,
    ),
    "the paper's soft-argmin offset": Named(
        file="training/model/fsmvsnet.py",
        before="return soft_argmin(probability, planes), mass",
        after=(
            "return soft_argmin(probability, planes + 0.5), mass",
            "return soft_argmin(probability, planes - 1), mass",
        ),
        tests=_model("test_soft_argmin_of_the_paper_is_the_mean_over_the_planes"),
    ),
    "the pyramid's bottom-up path": Named(
        file="training/model/backbone.py",
        before="self.after_bottom_up[i](levels[i + 1] + self.down[i](levels[i]))",
        after=("self.after_bottom_up[i](levels[i + 1])", "levels[i + 1]"),
        tests=_model("test_the_pyramid_hands_what_is_fine_on_to_what_is_coarse"),
    ),
    "optimizer state on resume": Named(
        file="training/train.py",
        before='        self.optimizer.load_state_dict(state["optimizer"])\n',
        after=("",),
        tests=("tests/training/test_train.py::test_a_resumed_run_has_its_optimizers_state",),
    ),
    "parity of the command line": Named(
        file="export/__main__.py",
        before="return 0 if parity.passes() else 1",
        after=("return 0", "return 1"),
        tests=("tests/export/test_command_line.py::test_parity_is_a_thousandth_of_the_depth_and_of_the_mask",),
    ),
    "parity tolerance of the command line": Named(
        file="export/parity.py",
        before="DEPTH_REL_P999, MASK_AGREEMENT = 1e-3, 0.999\n",
        after=(
            "DEPTH_REL_P999, MASK_AGREEMENT = 2e-3, 0.999\n",
            "DEPTH_REL_P999, MASK_AGREEMENT = 5e-4, 0.999\n",
            "DEPTH_REL_P999, MASK_AGREEMENT = 1e-3, 0.998\n",
            "DEPTH_REL_P999, MASK_AGREEMENT = 1e-3, 0.9995\n",
        ),
        tests=("tests/export/test_command_line.py::test_parity_is_a_thousandth_of_the_depth_and_of_the_mask",),
    ),
}


def ways_of(name: str, root: Path = ROOT) -> list[Mutant]:
    """The ways in which a named place is broken."""
    named = NAMED[name]
    source = (root / named.file).read_text(encoding="utf-8")
    if source.count(named.before) != 1:
        msg = f"{name}: {named.before.strip()!r} stands {source.count(named.before)} times in {named.file}"
        raise ValueError(msg)
    ahead = source[: source.index(named.before)]
    start = len(ahead.encode())
    line = ahead.count("\n") + 1
    return [
        Mutant(
            file=named.file,
            line=line,
            column=0,
            where=name,
            kind="named",
            start=start,
            end=start + len(named.before.encode()),
            before=named.before,
            after=after,
            code=named.before.strip(),
        )
        for after in named.after
    ]
