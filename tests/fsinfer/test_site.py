"""The documentation: links and file names that hold, a site that needs no network, forms that can be read."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest
import yaml

from tests.support.places import ROOT

DOCUMENTS = sorted(
    [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "models").glob("*.md")],
    key=lambda path: path.as_posix(),
)
LINK = re.compile(r"\]\((?!https?:|mailto:|#)([^)\s#]+)")
NAMED = re.compile(r"`((?:fsinfer|training|export|tests|docs|models)/[\w./-]+?/?)`")
CODE_BLOCK = re.compile(r"^```.*?^```", flags=re.DOTALL | re.MULTILINE)


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@pytest.mark.parametrize("document", DOCUMENTS, ids=name_of)
def test_links_lead_to_files_of_the_repository(document: Path) -> None:
    links = LINK.findall(CODE_BLOCK.sub("", document.read_text(encoding="utf-8")))
    assert [link for link in links if not (document.parent / link).exists()] == []


@pytest.mark.parametrize("document", DOCUMENTS, ids=name_of)
def test_files_that_are_named_are_there(document: Path) -> None:
    named = set(NAMED.findall(document.read_text(encoding="utf-8")))
    missing = {name for name in named if not (ROOT / name).exists()}
    # In the wheel the models lie inside the package; the folder of results comes with the first of them.
    missing -= {"fsinfer/models/", "docs/results", "docs/results/"}
    assert {name for name in missing if "NAME" not in name} == set()


class _Loads(HTMLParser):
    """What a page loads by itself; a link that a reader may follow is none."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        for key in ("src", "srcset", "data") + (("href",) if tag == "link" else ()):
            value = values.get(key) or ""
            if value.startswith(("http:", "https:", "//")):
                self.found.append(value)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def test_the_site_loads_nothing_from_elsewhere(site: Path) -> None:
    pages = sorted(site.rglob("*.html"))
    assert len(pages) > 15
    loads = _Loads()
    for page in pages:
        loads.feed(page.read_text(encoding="utf-8"))
    styles = [path.read_text(encoding="utf-8") for path in site.rglob("*.css")]
    assert styles
    assert loads.found == []
    assert [
        found for text in styles for found in re.findall(r"(?:url\(|@import\s)\s*[\"']?(?:https?:)?//[^)\"']*", text)
    ] == []


def test_the_site_has_the_reference_and_the_pages_from_elsewhere(site: Path) -> None:
    package = (site / "api" / "package.html").read_text(encoding="utf-8")
    for name in ("DepthModel", "DepthEstimate", "measure_trees", "Tree", "PointCloud", "read_cloud", "write_cloud"):
        assert f'id="fsinfer.{name}"' in package
    # Sections of docstrings are understood, not printed as they stand.
    assert "pixel centres at integer coordinates" in package
    assert "----" not in package
    assert "nearest and farthest z depth searched" in package
    for page, text in (("model-card", "Model card"), ("contributing", "By question"), ("changelog", "Unreleased")):
        assert text in (site / f"{page}.html").read_text(encoding="utf-8")
    # A link between files of the repository has become one between pages.
    assert 'href="model-card.html"' in (site / "index.html").read_text(encoding="utf-8")
    assert 'href="accuracy.html"' in (site / "model-card.html").read_text(encoding="utf-8")
    assert list(site.rglob("*.py")) == []


def test_every_public_name_is_in_the_reference(site: Path) -> None:
    import fsinfer

    text = "".join(page.read_text(encoding="utf-8") for page in (site / "api").glob("*.html"))
    names = [name for name in fsinfer.__all__ if not name.startswith("__") and name != "FsinferError"]
    assert [name for name in names if f'id="fsinfer.{name}"' not in text] == []
    errors = [name for name, kind in vars(fsinfer.errors).items() if isinstance(kind, type)]
    assert [name for name in errors if f'id="fsinfer.errors.{name}"' not in text] == []


def test_forms_and_workflows_can_be_read() -> None:
    forms = {path.stem: yaml.safe_load(path.read_text(encoding="utf-8")) for path in (ROOT / ".github").rglob("*.yml")}
    assert set(forms) == {"config", "plot_failed", "wrong_diameter", "feature", "checks"}
    for name in ("plot_failed", "wrong_diameter", "feature"):
        ids = [part.get("id") for part in forms[name]["body"] if part["type"] != "markdown"]
        assert None not in ids
        assert len(set(ids)) == len(ids)
    assert "fsinfer support OUT" in str(forms["plot_failed"])
    matrix = forms["checks"]["jobs"]["tests"]["strategy"]["matrix"]
    assert matrix["python"] == ["3.11", "3.12", "3.13", "3.14"]
    used = re.findall(r"uses: (\S+)", (ROOT / ".github" / "workflows" / "checks.yml").read_text(encoding="utf-8"))
    assert used
    assert [action for action in used if not re.fullmatch(r"actions/[\w-]+@v\d+", action)] == []
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    import fsinfer

    assert citation["version"] == fsinfer.__version__
