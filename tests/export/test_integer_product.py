"""The product of whole numbers that ships is the one that is written."""

from __future__ import annotations

import onnx

from export.integer_product import integer_product
from fsinfer.poses.integer_product import FILE


def test_the_file_is_what_is_written() -> None:
    shipped, written = onnx.load(FILE), integer_product()
    assert shipped.graph == written.graph
    assert shipped.opset_import == written.opset_import
    assert shipped.ir_version == written.ir_version
