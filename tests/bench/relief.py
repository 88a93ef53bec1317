"""The level breast height is counted from, on relief and under undergrowth: ``python -m tests.bench.relief``.

For each shape of tests/support/relief.py: stems found, how far their ground is off, and how many of those off by more
than 10 cm are called ok.
"""

from __future__ import annotations

import argparse

import numpy as np

from fsinfer.errors import CloudError
from fsinfer.trees import analyse_plot
from fsinfer.trees.tree import Tree
from tests.bench.results import add_result_options, check_result_options, save_result
from tests.support.relief import FEET, SHAPES, ReliefPlot, relief_plot

#: A stem this near to a foot is the one that stands there, metres; a level off by more is wrong.
NEAR_M, WRONG_M = 0.3, 0.1


def levels_off(plot: ReliefPlot, trees: tuple[Tree, ...]) -> list[tuple[float, Tree]]:
    """How far above the ground the level of each stem that was found lies, metres, with its tree."""
    found = []
    for (x, y), ground in zip(FEET, plot.ground_m, strict=True):
        near = [tree for tree in trees if np.hypot(tree.x_m - x, tree.y_m - y) < NEAR_M]
        found += [(tree.z_ground_m - float(ground), tree) for tree in near[:1]]
    return found


def main(argv: list[str] | None = None) -> int:
    """Run and print."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.relief", description=__doc__)
    parser.add_argument("--patches", type=int, default=20, help="of undergrowth")
    parser.add_argument("--seed", type=int, default=1)
    add_result_options(parser)
    args = parser.parse_args(argv)
    check_result_options(parser, args)
    figures: dict[str, float] = {}
    for name, shape in SHAPES.items():
        plot = relief_plot(shape, patches=args.patches, seed=args.seed)
        try:
            found = levels_off(plot, analyse_plot(plot.points).trees)
        except CloudError as error:
            print(f"{name:>18}: {error}")
            found = []
        off = np.array([abs(level) for level, _ in found])
        unsaid = sum(abs(level) > WRONG_M and tree.status == "ok" for level, tree in found)
        figures |= {f"{name}_stems": len(FEET), f"{name}_found": len(found), f"{name}_wrong_and_ok": unsaid}
        if not found:
            continue
        figures |= {
            f"{name}_level_rms_cm": 100 * float(np.sqrt((off**2).mean())),
            f"{name}_level_worst_cm": 100 * float(off.max()),
        }
        rms, worst = (figures[f"{name}_level_{which}_cm"] for which in ("rms", "worst"))
        print(
            f"{name:>18}: {len(found)} of {len(FEET)} stems, level off by {rms:.1f} cm (RMS), at worst {worst:.1f} cm; "
            f"by more than 10 cm and ok: {unsaid}",
            flush=True,
        )
    settings = {"patches": args.patches, "seed": args.seed}
    save_result(args, figures, module="tests.bench.relief", arguments=argv, settings=settings)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
