"""Numbers the depth network is computed with: float32, or 8-bit integers where the processor is fast at them.

On x86 that is where it has AVX2. Without VNNI onnxruntime adds up two products of 8 bits each in 16 bits there, which
weights of 8 bits could overflow; those of the int8 graphs have 7 (:mod:`export.quantize`), so that every processor
computes the same. ARM needs its dot products of 8-bit integers.
"""

from __future__ import annotations

import ctypes
import platform
from pathlib import Path

from fsinfer.depth.manifest import ModelManifest
from fsinfer.depth.session import is_processor
from fsinfer.depth.settings import Precision
from fsinfer.errors import InputError, ModelError

AUTO, FLOAT32, INT8 = Precision.auto.value, Precision.float32.value, Precision.int8.value
PRECISIONS = tuple(precision.value for precision in Precision)

# Names of the flags in /proc/cpuinfo.
_X86_FLAGS = frozenset({"avx2"})
_ARM_FLAGS = frozenset({"asimddp"})
#: PF_AVX2_INSTRUCTIONS_AVAILABLE of IsProcessorFeaturePresent (winnt.h). Source: format.
_WINDOWS_AVX2 = 40


def is_fast_at_int8(system: str, machine: str, *, cpuinfo: str = "", windows_avx2: bool = False) -> bool:
    """Whether a processor multiplies 8-bit integers faster than float32.

    Parameters
    ----------
    system, machine: as ``platform.system()`` and ``platform.machine()`` give them.
    cpuinfo: text of ``/proc/cpuinfo``, which Linux has; empty elsewhere.
    windows_avx2: whether Windows says that there is AVX2. Of Macs only Apple's own processors count.
    """
    if system == "Darwin":
        return machine == "arm64"
    if system == "Windows":
        return machine == "AMD64" and windows_avx2
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
    if manifest.int8_regularizer is None or not is_processor(provider):
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
    return is_fast_at_int8(platform.system(), platform.machine(), cpuinfo=cpuinfo, windows_avx2=_windows_has_avx2())


def _windows_has_avx2() -> bool:
    windows = getattr(ctypes, "windll", None)  # nowhere else
    return windows is not None and bool(windows.kernel32.IsProcessorFeaturePresent(_WINDOWS_AVX2))
