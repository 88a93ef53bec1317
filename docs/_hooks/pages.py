"""Pages of the site that are files elsewhere in the repository, and links between the two.

The repository is read on its own as well, so links in its files name files: ``../models/README.md``. On the site they
have to name pages.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path, PurePosixPath
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[2]
# Page of the site, and the file that it shows.
PAGES = {
    "model-card.md": "models/README.md",
    "contributing.md": "CONTRIBUTING.md",
    "changelog.md": "CHANGELOG.md",
    "security.md": "SECURITY.md",
}
_LINK = re.compile(r"(?<!!)\[(?P<label>[^\]]*)\]\((?P<target>[^)\s]+)\)")
_CODE = re.compile(r"(^```.*?^```|`[^`\n]*`)", flags=re.DOTALL | re.MULTILINE)


def on_config(config: Any) -> Any:
    """Put the files in place of a pattern in the navigation, such as ``trials-*.md``; there may be none."""
    config.nav = _expanded(config.nav, Path(config.docs_dir))
    return config


def _expanded(entry: Any, docs: Path) -> Any:
    if isinstance(entry, dict):
        return {title: _expanded(inner, docs) for title, inner in entry.items()}
    if not isinstance(entry, list):
        return entry
    items: list[Any] = []
    for item in entry:
        if isinstance(item, str) and "*" in item:
            items += sorted(path.relative_to(docs).as_posix() for path in docs.glob(item))
        else:
            items.append(_expanded(item, docs))
    return items


def on_files(files: Files, config: Any) -> Files:
    """Add the pages; a file that is gone ends the build."""
    for page, source in PAGES.items():
        files.append(File.generated(config, page, content=(ROOT / source).read_text(encoding="utf-8")))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Let links to files of the repository lead to their pages."""
    uri = page.file.src_uri
    return site_links(markdown, source=PAGES.get(uri, f"docs/{uri}"), page=uri)


def site_links(markdown: str, *, source: str, page: str) -> str:
    """Turn links between files of the repository into links between pages.

    Parameters
    ----------
    markdown: the text.
    source: its file in the repository.
    page: its place below the site's root.

    Returns
    -------
    The text. A link to a file that exists and is no page, such as source code, becomes its label; one to a file that
    does not exist stays, for the build to complain of.
    """

    def turn(found: re.Match[str]) -> str:
        path, hash_sign, anchor = found["target"].partition("#")
        if not path or ":" in path:
            return found[0]
        target = posixpath.normpath(posixpath.join(posixpath.dirname(source), path))
        for name, file in PAGES.items():
            if target == file:
                return f"[{found['label']}]({_relative(name, page)}{hash_sign}{anchor})"
        if PurePosixPath(target).parts[0] == "docs":
            return f"[{found['label']}]({_relative(target.removeprefix('docs/'), page)}{hash_sign}{anchor})"
        return found["label"] if (ROOT / target).exists() else found[0]

    # Brackets in code are no links.
    parts = _CODE.split(markdown)
    return "".join(part if number % 2 else _LINK.sub(turn, part) for number, part in enumerate(parts))


def _relative(target: str, page: str) -> str:
    return posixpath.relpath(target, posixpath.dirname(page) or ".")
