"""What fsinfer is made of: locked versions, licences, and the parts of a wheel.

python -m tests.supply lock                  # tests/locked anew after a change of pyproject.toml; needs pip install uv
python -m tests.supply lock --upgrade        # with the newest versions
python -m tests.supply licences              # of all that is needed, as docs/licences.md; ends with 1 at a refused one
python -m tests.supply licences --write      # into that page; --check compares only
python -m tests.supply wheel DIST.whl        # its files and models are those it lists
python -m tests.supply sbom DIST.whl OUT.json
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

from tests.supply import licences, lock, sbom
from tests.supply import wheel as wheels
from tests.supply.installed import MissingPackage, installed
from tests.support.places import ROOT

PAGE = ROOT / "docs" / "licences.md"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.supply", description=__doc__.partition("\n")[0])
    commands = parser.add_subparsers(dest="command", required=True)
    locking = commands.add_parser("lock", help="write the locked versions")
    locking.add_argument("--upgrade", action="store_true", help="the newest ones, also where nothing asks for them")
    listing = commands.add_parser("licences", help="list the licences; fail at one that is refused")
    what = listing.add_mutually_exclusive_group()
    what.add_argument("--write", action="store_true", help="into docs/licences.md")
    what.add_argument("--check", action="store_true", help="fail where docs/licences.md says something else")
    checking = commands.add_parser("wheel", help="compare a wheel with its list of files and the models' manifests")
    checking.add_argument("wheel", type=Path)
    parts = commands.add_parser("sbom", help="list the parts of a wheel in CycloneDX")
    parts.add_argument("wheel", type=Path)
    parts.add_argument("out", type=Path)
    arguments = parser.parse_args()
    try:
        _run(arguments)
    except (MissingPackage, OSError, subprocess.CalledProcessError) as error:
        sys.exit(str(error))


def _run(arguments: argparse.Namespace) -> None:
    if arguments.command == "lock":
        lock.write_locks(upgrade=arguments.upgrade)
    elif arguments.command == "licences":
        found = licences.groups(installed())
        text = licences.page(found)
        if arguments.write:
            PAGE.write_text(text, encoding="utf-8", newline="\n")
        elif not arguments.check:
            print(text)
        wrong = [fault for members in found.values() for fault in licences.faults(members)]
        if arguments.check and PAGE.read_text(encoding="utf-8") != text:
            wrong.append(f"{PAGE.name} is stale: python -m tests.supply licences --write")
        _end(wrong)
    elif arguments.command == "wheel":
        _end(wheels.faults(wheels.Wheel(arguments.wheel)))
    else:
        sbom.write_sbom(wheels.Wheel(arguments.wheel), installed(), arguments.out)


def _end(wrong: list[str]) -> None:
    """End with 1 and what is wrong, if anything is."""
    if wrong:
        sys.exit("\n".join(wrong))


if __name__ == "__main__":
    main()
