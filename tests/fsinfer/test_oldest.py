"""The oldest versions that are tried are those that pyproject.toml promises."""

from __future__ import annotations

import re
import tomllib

from tests.support.places import ROOT


def test_the_constraints_are_the_lower_bounds() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    bounds = []
    for dependency in (*project["dependencies"], *extras["gis"], *extras["cluster"], *extras["train"]):
        if dependency.startswith("torch=="):  # one version, the oldest and the newest
            continue
        found = re.fullmatch(r"([\w-]+)(?:\[[\w,-]+\])?>=([\w.]+)(?:,[<!].+)?(?:; .+)?", dependency)
        assert found, f"{dependency} has no lower bound to try"
        bounds.append(f"{found[1]}=={found[2]}")
    lines = (ROOT / "tests" / "constraints-oldest.txt").read_text(encoding="utf-8").splitlines()
    assert [line for line in lines if line and not line.startswith("#")] == bounds
