"""An environment whose programs believe that the processor has AVX2 and no more, at the speed of the processor itself.

python -m tests.bench.without_avx512 OUT                     a copy of the environment of this Python, 5 minutes
OUT/without-avx512 python -m tests.bench.plot PLOT PLOT-OUT  anything in it

A processor with AVX-512 is no laptop with AVX2: its cache and memory are its own. But what libraries choose by the
processor they choose as there. Neither onnxruntime nor all of OpenBLAS can be told to leave AVX-512 alone, and an
emulator is a hundred times slower. So every library of the copy that asks the processor what it can (CPUID) asks a
preloaded one instead (``without_avx512.c``), which leaves AVX-512, VNNI and AMX out; glibc is told by its own setting.
Linux on x86-64; needs a C compiler and objdump (binutils). Result files say so in the name of the processor.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import stat
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from tests.bench.results import WITHOUT_AVX512

SOURCE = Path(__file__).with_suffix(".c")
PRELOADED = f"lib{WITHOUT_AVX512}.so"
#: glibc's own copies and sums of memory.
GLIBC = "glibc.cpu.hwcaps=-AVX512F,-AVX512VL,-AVX512BW,-AVX512DQ,-AVX512CD,-AVX512ER,-AVX512PF"
CPUID, UD2 = b"\x0f\xa2", b"\x0f\x0b"

_INSTRUCTION = re.compile(r"^\s*([0-9a-f]+):\s+cpuid\s*$", flags=re.MULTILINE)
#: Name, size, address and place in the file of a section, as objdump lists them.
_SECTION = re.compile(r"^\s*\d+\s+(\S+)\s+([0-9a-f]+)\s+([0-9a-f]+)\s+[0-9a-f]+\s+([0-9a-f]+)\s", flags=re.MULTILINE)


def copy_environment(source: Path, out: Path) -> Path:
    """Copy a virtual environment to OUT, with its libraries changed; the command that starts programs in it."""
    shutil.copytree(source, out, symlinks=True)
    for script in (out / "bin").iterdir():
        if script.is_file() and not script.is_symlink():
            text = script.read_bytes()
            script.write_bytes(text.replace(str(source).encode(), str(out).encode()))
    for library in libraries(out):
        places = hide_cpuid(library)
        if places:
            print(f"{library.relative_to(out)}: {places}", flush=True)
    preloaded = out / PRELOADED
    compile_answer(preloaded)
    starter = out / "without-avx512"
    starter.write_text(
        f'#!/bin/sh\nLD_PRELOAD="{preloaded}" GLIBC_TUNABLES="{GLIBC}" PATH="{out}/bin:$PATH" exec "$@"\n',
        encoding="utf-8",
    )
    starter.chmod(starter.stat().st_mode | stat.S_IXUSR)
    return starter


def compile_answer(out: Path) -> None:
    """Compile the library that answers in the processor's place."""
    subprocess.run(["cc", "-O2", "-Wall", "-Werror", "-shared", "-fPIC", str(SOURCE), "-o", str(out)], check=True)


def libraries(folder: Path) -> Iterator[Path]:
    """Shared libraries in a folder, each once."""
    for path in sorted(folder.rglob("*.so*")):
        if path.is_file() and not path.is_symlink():
            with path.open("rb") as stream:
                is_library = stream.read(4) == b"\x7fELF"
            if is_library:
                yield path


def hide_cpuid(library: Path) -> int:
    """Replace each CPUID instruction of a library by UD2; how many there were.

    Raises
    ------
    ValueError
        An instruction is not where the list of sections says.
    """
    content = bytearray(library.read_bytes())
    if CPUID not in content:
        return 0
    addresses = [int(found, 16) for found in _INSTRUCTION.findall(_objdump(library, "-d", "--no-show-raw-insn"))]
    sections = [[int(part, 16) for part in found[1:]] for found in _SECTION.findall(_objdump(library, "-h"))]
    for address in addresses:
        place = next(
            (offset + address - start for size, start, offset in sections if start <= address < start + size), -1
        )
        if place < 0 or content[place : place + 2] != CPUID:
            raise ValueError(f"{library}: no CPUID at {address:#x}")
        content[place : place + 2] = UD2
    if addresses:
        # A new file: the old one may be a hard link to the environment that was copied.
        library.unlink()
        library.write_bytes(content)
    return len(addresses)


def _objdump(library: Path, *options: str) -> str:
    return subprocess.run(["objdump", *options, str(library)], check=True, capture_output=True, text=True).stdout


def main(argv: list[str] | None = None) -> int:
    """Copy, change, say how to use it."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.without_avx512", description=__doc__)
    parser.add_argument("out", type=Path, help="must not be there yet")
    args = parser.parse_args(argv)
    if args.out.exists():
        parser.error(f"{args.out} is there already; give a new folder")
    if sys.prefix == sys.base_prefix:
        parser.error("this Python is of no virtual environment; start the one of the environment to copy")
    missing = [tool for tool in ("cc", "objdump") if shutil.which(tool) is None]
    if os.name != "posix" or missing:
        parser.error(f"needs Linux, a C compiler and objdump; not found: {', '.join(missing) or 'Linux'}")
    starter = copy_environment(Path(sys.prefix), args.out.resolve())
    print(f"{starter} python -m tests.bench.speed --pairs 3")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
