"""``trees.json``: for each tree its status and the reasons for it, as codes with values and in words."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from fsinfer.io.files import write_text
from fsinfer.notices.notice import Notice, notice_json
from fsinfer.notices.sentences import advises_revisit, sentence
from fsinfer.trees.tree import Tree


def write_reasons(path: Path, trees: Sequence[Tree]) -> None:
    """Write ``tree_id``, ``status`` and ``reasons`` of each tree; an empty list where there are no trees."""
    entries = [
        {"tree_id": tree.tree_id, "status": tree.status, "reasons": [_reason(why) for why in tree.reasons]}
        for tree in trees
    ]
    write_text(path, json.dumps(entries, indent=1, ensure_ascii=False) + "\n")


def _reason(why: Notice) -> dict[str, object]:
    return notice_json(why) | {"text": sentence(why), "advises_revisit": advises_revisit(why)}
