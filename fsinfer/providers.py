"""Where the network is computed: the processor, or what another build of onnxruntime offers."""

from __future__ import annotations

from fsinfer.errors import ModelError

CPU = "CPUExecutionProvider"

#: Short names of onnxruntime's execution providers; any other is given by its full name.
PROVIDERS = {
    "cpu": CPU,
    "cuda": "CUDAExecutionProvider",
    "tensorrt": "TensorrtExecutionProvider",
    "rocm": "ROCMExecutionProvider",
    "coreml": "CoreMLExecutionProvider",
    "directml": "DmlExecutionProvider",
    "openvino": "OpenVINOExecutionProvider",
}


def find_providers(name: str, available: list[str]) -> list[str]:
    """Execution providers to ask for, best first; the processor does what the chosen one cannot.

    Parameters
    ----------
    name: a key of :data:`PROVIDERS` in any case, or onnxruntime's own name.
    available: those of the installed onnxruntime (``onnxruntime.get_available_providers()``).

    Raises
    ------
    ModelError
        The installed onnxruntime does not have it.
    """
    wanted = PROVIDERS.get(name.lower(), name)
    if wanted not in available:
        short = {long: key for key, long in PROVIDERS.items()}
        have = ", ".join(sorted(short.get(provider, provider) for provider in available))
        msg = (
            f"this onnxruntime has no provider {name!r}, only: {have}; leave --provider out, or install another build "
            "of onnxruntime (onnxruntime-gpu for cuda, onnxruntime-directml for directml) in place of this one"
        )
        raise ModelError(msg)
    return [CPU] if wanted == CPU else [wanted, CPU]
