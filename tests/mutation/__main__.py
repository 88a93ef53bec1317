"""Break the modules that figures hang on, one place at a time, and see whether their tests notice.

python -m tests.mutation                            # 25 breakages of each module; goes on where it was stopped
python -m tests.mutation dbh spread --per-module 0  # every breakage of two of them
python -m tests.mutation --named                    # those that a review found unnoticed, by hand
python -m tests.mutation --report docs/mutation.md  # what is known so far; runs nothing

No file is touched: the broken module is imported from memory. What was found is kept in tests/mutation/results.jsonl,
which is part of the repository, so that the same command goes on where it was stopped, on another machine too; a
breakage that survived is tried again when the tests of its module change. Delete the file to try all of them again.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import sys
from collections.abc import Sequence
from functools import cache
from itertools import islice
from pathlib import Path

from tests.mutation.mutants import Mutant, is_python, mutants_of
from tests.mutation.named import NAMED, ways_of
from tests.mutation.record import Record, digest_of, write_report
from tests.mutation.targets import TARGETS, Target
from tests.mutation.trial import Outcome, load_libraries, try_tests
from tests.support.places import ROOT

#: A trial may take so many times the seconds of a core that the sound tests take, and so many more.
TIMES, SECONDS_MORE = 4.0, 20.0
#: Breakages of a module that are tried where nobody says how many.
PER_MODULE = 25
#: What became of each breakage, by hours of work.
RESULTS = Path(__file__).with_name("results.jsonl")


def sample(target: Target, name: str, count: int, seed: int, root: Path = ROOT) -> list[Mutant]:
    """``count`` breakages of a target's files, all where it is 0; a larger count holds those of a smaller one.

    They are drawn by their names: another line in a file leaves the others in the sample.
    """
    sources = {file: (root / file).read_text(encoding="utf-8") for file in target.files}
    every = [mutant for file, source in sources.items() for mutant in mutants_of(source, file)]
    every.sort(key=lambda mutant: hashlib.sha256(f"{seed} {name} {mutant.name}".encode()).digest())
    usable = (mutant for mutant in every if is_python(mutant.apply(sources[mutant.file])))
    return list(usable if count == 0 else islice(usable, count))


@cache
def _sound(tests: tuple[str, ...]) -> Outcome:
    """What the tests say of what is not broken."""
    return try_tests(ROOT, tests, limit_s=1800.0)


def run_target(name: str, mutants: Sequence[Mutant], tests: Sequence[str], record: Record) -> None:
    """Try the breakages that are not known yet against their tests, and note each at once."""
    version = digest_of(tests)
    open_ = [mutant for mutant in mutants if not record.knows(mutant, version)]
    if not open_:
        return
    sound = _sound(tuple(tests))
    if sound.state != "survived":
        sys.exit(f"{name}: the tests fail without any breakage ({sound.by or sound.state})")
    print(f"{name}: {len(open_)} breakages, the sound tests take {sound.seconds:.0f} s of a core", flush=True)
    for number, mutant in enumerate(open_, start=1):
        source = (ROOT / mutant.file).read_text(encoding="utf-8")
        limit = TIMES * sound.seconds + SECONDS_MORE
        outcome = try_tests(ROOT, tests, limit_s=limit, broken=(mutant.file, mutant.apply(source)))
        record.note(name, mutant, version, outcome)
        said = f"{mutant.file}:{mutant.line} {mutant.kind}: {mutant.before} -> {mutant.after}"
        print(
            f"  {number}/{len(open_)} {outcome.state:8} {outcome.seconds:5.1f} s  {' '.join(said.split())}", flush=True
        )


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.mutation", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("modules", nargs="*", choices=[[], *TARGETS], metavar="MODULE", help=", ".join(TARGETS))
    parser.add_argument("--per-module", type=int, default=PER_MODULE, help="breakages of each; 0 tries all")
    parser.add_argument("--seed", type=int, default=0, help="of the choice among them")
    parser.add_argument("--named", action="store_true", help="only the breakages of tests/mutation/named.py")
    parser.add_argument("--report", type=Path, metavar="FILE", help="only write what is known so far as a page")
    args = parser.parse_args(argv)
    chosen = {name: sample(TARGETS[name], name, args.per_module, args.seed) for name in (args.modules or list(TARGETS))}
    named = {name: ways_of(name) for name in NAMED}
    record = Record(RESULTS)
    if args.report is None:
        todo = [(name, mutants, NAMED[name].tests) for name, mutants in named.items()]
        if not args.named:
            todo = [(name, mutants, TARGETS[name].tests) for name, mutants in chosen.items()]
        files = {mutant.file for _, mutants, _ in todo for mutant in mutants}
        with_torch = any(file.startswith(("training", "export")) for file in files)
        load_libraries(ROOT / ".mutation" / "bytecode", with_torch=with_torch)
        for name, mutants, tests in todo:
            run_target(name, mutants, tests, record)
    text = write_report(chosen, named, record, seed=args.seed, per_module=args.per_module)
    if args.report is not None:
        args.report.write_text(text, encoding="utf-8")
    else:
        print(text)
    return 0


if __name__ == "__main__":
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    os.environ.setdefault("MPLBACKEND", "Agg")
    raise SystemExit(main())
