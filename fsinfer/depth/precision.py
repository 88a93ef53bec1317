"""Numbers the regularizer is computed with: float32, or 8-bit integers where the processor has instructions for them.

Without dot products of 8-bit integers that add up in 32 bits, a sum of two products would be cut off at 16 bits on
x86 (AVX2 alone): wrong, and no faster. So the choice asks for VNNI there, and for the like instructions of ARM.
"""

from __future__ import annotations

import platform
from pathlib import Path

from fsinfer.depth.manifest import ModelManifest
from fsinfer.depth.settings import Precision
from fsinfer.errors import InputError, ModelError

AUTO, FLOAT32, INT8 = Precision.auto.value, Precision.float32.value, Precision.int8.value
PRECISIONS = tuple(precision.value for precision in Precision)

# Names of the flags in /proc/cpuinfo.
_X86_FLAGS = frozenset({"avx512_vnni", "avx_vnni"})
_ARM_FLAGS = frozenset({"asimddp"})


def has_int8_dot_products(system: str, machine: str, cpuinfo: str) -> bool:
    """Whether a processor multiplies and adds 8-bit integers in one instruction.

    Parameters
    ----------
    system, machine: as ``platform.system()`` and ``platform.machine()`` give them.
    cpuinfo: text of ``/proc/cpuinfo``; empty where there is none. Linux only: elsewhere only Apple's own processors
        are known to have them.
    """
    if system == "Darwin":
        return machine == "arm64"
    if system != "Linux":
        return False
    wanted = {"x86_64": _X86_FLAGS, "aarch64": _ARM_FLAGS}.get(machine, frozenset[str]())
    # Every core has its line, and work may land on any of them.
    cores = [set(line.split(":", 1)[1].split()) for line in cpuinfo.splitlines() if _is_flags(line)]
    return bool(cores) and all(flags & wanted for flags in cores)


def choose_precision(wanted: str, manifest: ModelManifest, *, provider: str = "cpu", fast: bool | None = None) -> str:
    """The precision to compute with: ``float32`` or ``int8``.

    Parameters
    ----------
    wanted: one of :data:`PRECISIONS`. ``auto`` takes int8 where the model has it, depth is computed on the processor,
        and that one is fast at it.
    manifest: of the model.
    provider: see :mod:`fsinfer.depth.session`.
    fast: whether the processor is fast at int8; ``None`` finds out.

    Raises
    ------
    InputError
        No such precision.
    ModelError
        int8 was asked for, and the model has no such file.
    """
    if wanted not in PRECISIONS:
        msg = f"no precision {wanted!r}; choose one of {', '.join(PRECISIONS)}"
        raise InputError(msg)
    if wanted == INT8 and manifest.int8_regularizer is None:
        msg = (
            f"model {manifest.name} in {manifest.folder} has no int8 regularizer; leave --precision out, or make one "
            "with python -m export.quantize"
        )
        raise ModelError(msg)
    if wanted != AUTO:
        return wanted
    if manifest.int8_regularizer is None or provider.lower() not in ("cpu", "cpuexecutionprovider"):
        return FLOAT32
    fast = _this_machine_is_fast() if fast is None else fast
    return INT8 if fast else FLOAT32


def _is_flags(line: str) -> bool:
    return line.split(":", 1)[0].strip() in ("flags", "Features") and ":" in line


def _this_machine_is_fast() -> bool:
    try:
        cpuinfo = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        cpuinfo = ""
    return has_int8_dot_products(platform.system(), platform.machine(), cpuinfo)
