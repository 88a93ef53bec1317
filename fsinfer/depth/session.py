"""Sessions of onnxruntime: on the processor, or on what another build of onnxruntime offers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsinfer.depth.map_levels import MapLevels
from fsinfer.depth.network_input import Levels
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


def is_processor(provider: str) -> bool:
    """Whether this name of an execution provider, as :func:`find_providers` takes it, is the processor's."""
    return provider.lower() in ("cpu", CPU.lower())


# What onnxruntime says where an allocation fails.
_NO_MEMORY = ("Failed to allocate memory", "bad allocation", "bad_alloc")


def available_providers() -> list[str]:
    """Execution providers of the installed onnxruntime, by their full names."""
    import onnxruntime

    return list(onnxruntime.get_available_providers())


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


class Graph:
    """A session of onnxruntime of which everything that goes wrong is told as a :class:`ModelError`.

    ``levels`` are those in which it takes a photograph, ``map_levels`` those in which it gives out each of its feature
    maps; ``None`` where they are numbers in 32 bits.
    """

    def __init__(
        self,
        file: Path,
        session: Any,
        levels: Levels | None = None,
        map_levels: Sequence[MapLevels | None] = (),
    ) -> None:
        self.file, self.session, self.levels, self.map_levels = file, session, levels, map_levels

    def get_inputs(self) -> list[Any]:
        """Names, types and shapes of what it takes."""
        return list(self.session.get_inputs())

    def run(self, outputs: Sequence[str] | None, feeds: Mapping[str, NDArray[np.float32]], options: Any = None) -> Any:
        """As the session does; raises MemoryError where there is too little of it."""
        try:
            return self.session.run(outputs, feeds, options)
        except Exception as error:  # onnxruntime raises its own family of exceptions
            if any(word in str(error) for word in _NO_MEMORY):
                raise MemoryError(str(error)) from error
            msg = f"{self.file} does not compute what its manifest says ({error}); re-export the model"
            raise ModelError(msg) from error

    def run_two(self, feeds: Mapping[str, NDArray[np.float32]]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """The two outputs (h, w) of a regularizer or a refiner; :class:`ModelError` where they are something else."""
        outputs = self.run(None, feeds)
        if len(outputs) != 2 or any(output.ndim != 2 for output in outputs) or outputs[0].shape != outputs[1].shape:
            shapes = [output.shape for output in outputs]
            msg = f"{self.file} gives {shapes}, not an index and a confidence of one size; re-export the model"
            raise ModelError(msg)
        return outputs[0], outputs[1]

    def run_parts(self, inputs: NDArray[np.float32]) -> NDArray[np.float32]:
        """What a graph of :mod:`fsinfer.depth.surface` gives of the four parts of a map (4, h, w).

        ``inputs`` (C, h, w) are those of :func:`fsinfer.depth.surface.surface_inputs`. Raises :class:`ModelError` where
        what it gives is something else.
        """
        outputs = self.run(None, {"inputs": inputs})
        if len(outputs) != 1 or outputs[0].shape != (4, *inputs.shape[1:]):
            shapes = [output.shape for output in outputs]
            msg = f"{self.file} gives {shapes}, not one map in four parts; re-export the model"
            raise ModelError(msg)
        return np.asarray(outputs[0], np.float32)


def load_graph(file: Path, threads: int, providers: Sequence[str]) -> Graph:
    """A session of onnxruntime; raises :class:`ModelError`."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    # Of what fails the error tells; onnxruntime would print it a second time.
    options.log_severity_level = 4
    # A plan of the memory makes onnxruntime keep one block for all of a run: 2.2 instead of 1.4 GB, and no faster.
    options.enable_mem_pattern = False
    # Threads that wait by spinning take the cores from those that build the cost volume.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    try:
        session = onnxruntime.InferenceSession(file, options, providers=list(providers))
        notes = session.get_modelmeta().custom_metadata_map
        map_levels = [MapLevels.noted(notes, output.name) for output in session.get_outputs()]
        return Graph(file, session, Levels.noted(notes), map_levels)
    except Exception as error:  # onnxruntime raises its own family of exceptions
        msg = f"{file} cannot be loaded by onnxruntime ({error}); install fsinfer again or re-export the model"
        raise ModelError(msg) from error


def run_for(
    session: Graph, outputs: Sequence[str], feeds: Mapping[str, NDArray[np.float32]]
) -> list[NDArray[np.float32]]:
    """Run only that part of a graph which the named outputs need; onnxruntime runs all of it otherwise."""
    import onnxruntime

    options = onnxruntime.RunOptions()
    options.only_execute_path_to_fetches = True
    return list(session.run(list(outputs), dict(feeds), options))
