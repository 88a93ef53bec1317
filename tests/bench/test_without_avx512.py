"""AVX-512 hidden: a library that asks the processor is answered without it, and the result file says so."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.bench.results import processor
from tests.bench.without_avx512 import PRELOADED, compile_answer, hide_cpuid, libraries

#: Says what leaf 7 has in EBX (bit 5: AVX2, 16: AVX-512F), and a sum with the bytes of CPUID in its constant.
LIBRARY = """
unsigned features(void) {
    unsigned a = 7, b, c = 0, d;
    __asm__ volatile("cpuid" : "+a"(a), "=b"(b), "+c"(c), "=d"(d));
    return b;
}
unsigned sum(unsigned x) { return x + 0x1234a20fu; }
"""
ASK = "import ctypes, sys; lib = ctypes.CDLL(sys.argv[1]); lib.features.restype = lib.sum.restype = ctypes.c_uint32; "
TOOLS = sys.platform == "linux" and os.uname().machine == "x86_64" and all(map(shutil.which, ("cc", "objdump")))


@pytest.mark.skipif(not TOOLS, reason="needs Linux on x86-64, a C compiler and objdump")
def test_a_library_is_told_of_no_avx512_and_nothing_else_in_it_changes(tmp_path: Path) -> None:
    (tmp_path / "a.c").write_text(LIBRARY)
    library = tmp_path / "lib" / "liba.so"
    library.parent.mkdir()
    subprocess.run(["cc", "-O1", "-shared", "-fPIC", str(tmp_path / "a.c"), "-o", str(library)], check=True)

    def ask(**environment: str) -> tuple[int, int]:
        words = [sys.executable, "-c", ASK + "print(lib.features(), lib.sum(1))", str(library)]
        said = subprocess.run(words, check=True, capture_output=True, text=True, env={**os.environ, **environment})
        features, one_more = said.stdout.split()
        return int(features), int(one_more)

    before = ask()
    assert list(libraries(tmp_path)) == [library]
    assert hide_cpuid(library) == 1
    assert hide_cpuid(library) == 0  # none is left
    compile_answer(tmp_path / PRELOADED)
    after = ask(LD_PRELOAD=str(tmp_path / PRELOADED))
    hidden = sum(1 << bit for bit in (16, 17, 21, 26, 27, 28, 30, 31))
    assert after == (before[0] & ~hidden, 0x1234A210)
    assert after[0] & hidden == 0


def test_the_result_file_says_that_it_was_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("LD_PRELOAD", raising=False)
    assert "hidden" not in processor()["model"]
    monkeypatch.setenv("LD_PRELOAD", f"/somewhere/{PRELOADED}")
    said = processor()
    assert said["model"].endswith("AVX-512 hidden")
    assert said["instructions"] != "avx512"
    assert said["vnni"] is False
