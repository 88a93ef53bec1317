"""Errors come out of another process as what they were."""

from __future__ import annotations

import errno
import json
import traceback

import numpy as np
import pytest

from fsinfer.cli.console import explain
from fsinfer.errors import OutputError, PosesError
from fsinfer.trees.sanity import TurnedCloudError
from fsinfer.workflow.error_json import error_json, error_of_json

ERRORS = [
    PosesError("3 of 40 photos registered; take more"),
    OutputError("cannot write " + 3000 * "x"),
    OSError(errno.ENOSPC, "No space left on device", "/there/a.jpg"),
    OSError("no number"),
    MemoryError(),
    KeyError("a"),
    ValueError("two", 2),
    UnicodeDecodeError("utf-8", b"\xff", 0, 1, "invalid start byte"),
    np.linalg.LinAlgError("Singular matrix"),
]


def there_and_back(error: Exception) -> Exception:
    try:
        raise error
    except Exception as caught:
        return error_of_json(json.loads(json.dumps(error_json(caught))))


@pytest.mark.parametrize("error", ERRORS, ids=repr)
def test_the_user_is_told_the_same_with_the_same_exit_code(error: Exception) -> None:
    back = there_and_back(error)
    message, code = explain(back)
    if isinstance(error, (UnicodeDecodeError, np.linalg.LinAlgError)):
        assert isinstance(back, RuntimeError)
        assert f"RuntimeError: {type(error).__name__}: {error}" in message
        assert code == 1
    else:
        assert type(back) is type(error)
        assert (message, code) == explain(error)
    trace = "".join(traceback.format_exception(back))
    # Where it was raised, in the other process.
    assert "in there_and_back\n    raise error" in trace
    assert "direct cause" in trace


def test_an_error_of_a_stage_counts_as_the_one_that_all_know() -> None:
    back = there_and_back(TurnedCloudError("side", np.eye(3)))
    assert (type(back).__name__, str(back)) == ("CloudError", str(TurnedCloudError("side", np.eye(3))))
    assert explain(back)[1] == 2
