"""``trees.json``: for each tree its status and the reasons for it, as codes with values and in words."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from fsinfer.errors import InputError
from fsinfer.io.files import write_text
from fsinfer.io.json_text import read_json
from fsinfer.notices.notice import Notice, notice_json, notice_of_json
from fsinfer.notices.sentences import advises_revisit, sentence
from fsinfer.trees.tree import Tree


def write_reasons(path: Path, trees: Sequence[Tree]) -> None:
    """Write ``tree_id``, ``status`` and ``reasons`` of each tree; an empty list where there are no trees."""
    entries = [
        {"tree_id": tree.tree_id, "status": tree.status, "reasons": [_reason(why) for why in tree.reasons]}
        for tree in trees
    ]
    write_text(path, json.dumps(entries, indent=1, ensure_ascii=False) + "\n")


def read_reasons(path: Path) -> dict[int, tuple[Notice, ...]]:
    """The reasons by ``tree_id``, as :func:`write_reasons` wrote them; :class:`InputError` for anything else."""
    try:
        return {int(entry["tree_id"]): tuple(map(notice_of_json, entry["reasons"])) for entry in read_json(path)}
    except (OSError, TypeError, KeyError, ValueError) as error:
        msg = f"cannot read {path} ({error}); delete its folder and run the command again"
        raise InputError(msg) from error


def _reason(why: Notice) -> dict[str, object]:
    return notice_json(why) | {"text": sentence(why), "advises_revisit": advises_revisit(why)}
