"""Settings become JSON, and results come back from it as what they were."""

from __future__ import annotations

import types
from dataclasses import dataclass
from enum import Enum, StrEnum
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.notices.notice import Notice
from fsinfer.output.json_values import as_json, of_json


class Rule(StrEnum):
    uphill = "uphill"


@dataclass(frozen=True, kw_only=True)
class Inner:
    name: str
    size: float | None


@dataclass(frozen=True, kw_only=True)
class Other:
    ends: tuple[tuple[float, float], tuple[float, float]]


@dataclass(frozen=True, kw_only=True)
class Result:
    path: Path
    rule: Rule
    pair: tuple[int, str]
    many: tuple[Inner, ...]
    by_name: dict[str, float]
    either: Inner | Other | None
    notices: tuple[Notice, ...] = ()


def result(folder: Path) -> Result:
    return Result(
        path=folder / "a" / "b.ply",
        rule=Rule.uphill,
        pair=(1, "one"),
        many=(Inner(name="x", size=None), Inner(name="y", size=2.0)),
        by_name={"k": 0.5},
        either=Other(ends=((0.0, 1.0), (2.0, 3.0))),
        notices=(Notice(code="blurred", items=(("names", ("a", "b")), ("share", 0.25))),),
    )


def test_a_result_comes_back_as_it_was_and_from_a_folder_that_was_moved(tmp_path: Path) -> None:
    here, there = tmp_path / "here", tmp_path / "there"
    written = as_json(result(here), folder=here)
    assert written["path"] == "a/b.ply"
    assert of_json(Result, written, folder=here) == result(here)
    assert of_json(Result, written, folder=there) == result(there)


def test_arrays_come_back(tmp_path: Path) -> None:
    read = of_json(Placed, as_json(Placed(matrix=np.eye(4))))
    assert read.matrix.dtype == np.float64
    np.testing.assert_array_equal(read.matrix, np.eye(4))


@dataclass(frozen=True, kw_only=True)
class Placed:
    matrix: NDArray[np.float64]


class _Alias:
    """As ``type NDArray[T] = ndarray[tuple[Any, ...], dtype[T]]`` of Python 3.12, with which NumPy 2.5 has it."""

    __value__ = np.ndarray[tuple[Any, ...], np.dtype[Any]]


def test_arrays_come_back_whatever_their_type_is_called() -> None:
    """With NumPy 2.5 every run ended in a fault when the first array of a record was read."""
    kind: Any = types.GenericAlias(_Alias, (np.float64,))
    np.testing.assert_array_equal(of_json(kind, [[1.0, 2.0]]), np.array([[1.0, 2.0]]))


@pytest.mark.parametrize(
    "value", [{"name": "x"}, {"name": "x", "size": 1.0, "more": 2}, {"name": 3, "size": 1.0}, [1], None]
)
def test_what_another_version_wrote_is_refused(value: object) -> None:
    with pytest.raises(TypeError):
        of_json(Inner, value)


def test_settings_become_json() -> None:
    class Plain(Enum):
        uphill = "uphill"

    @dataclass(frozen=True, kw_only=True)
    class Settings:
        rule: Plain = Plain.uphill
        sizes: tuple[int, ...] = (1, 2)
        matrix: object = None
        path: Path = Path("a")

    value = as_json({"s": Settings(matrix=np.eye(2)), "n": np.float32(0.5)})
    assert value == {
        "s": {"rule": "uphill", "sizes": [1, 2], "matrix": [[1.0, 0.0], [0.0, 1.0]], "path": "a"},
        "n": 0.5,
    }
    with pytest.raises(TypeError, match="object"):
        as_json(object())
