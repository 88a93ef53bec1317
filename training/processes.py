"""Several processes that train one model: ``torchrun`` starts them, gradients are averaged before every step.

One collective a step over one flat tensor instead of ``DistributedDataParallel``: a process may leave a sample out
whose loss is not finite, presets have heads without a gradient, and the moving average wants the same batch-norm
statistics everywhere; a few hundred thousand weights are little to send.
"""

from __future__ import annotations

import os
from dataclasses import dataclass

import torch
import torch.distributed as dist
from torch import nn

from fsinfer.errors import InputError


@dataclass(frozen=True, kw_only=True)
class Processes:
    """This process among those that train together.

    Attributes
    ----------
    rank: 0 is the one that validates, writes and prints. count: of all. local_rank: among those of this machine.
    """

    rank: int = 0
    count: int = 1
    local_rank: int = 0

    @property
    def leads(self) -> bool:
        """Whether this process writes checkpoints and logs."""
        return self.rank == 0

    def device(self, wanted: str) -> torch.device:
        """``auto``, ``cpu`` or ``cuda`` as a device; the GPUs are shared out, several processes a GPU if need be.

        Raises :class:`InputError` where this computer has no such device.
        """
        kind = ("cuda" if torch.cuda.is_available() else "cpu") if wanted == "auto" else wanted
        gpus = torch.cuda.device_count() if torch.cuda.is_available() else 0
        try:
            device = torch.device(kind)
        except RuntimeError:
            device = None
        if device is None or (device.type == "cuda" and (device.index or 0) >= gpus):
            msg = f"--device {wanted}: PyTorch finds no such device on this computer; give auto, or cpu"
            raise InputError(msg)
        return torch.device("cuda", self.local_rank % gpus) if kind == "cuda" and self.count > 1 else device

    def average_gradients(self, model: nn.Module) -> None:
        """Give every process the mean over all of the gradients and of the batch-norm statistics.

        A process without a gradient for a parameter counts as zero; what has none anywhere keeps none.
        """
        if self.count == 1:
            return
        parameters = [p for p in model.parameters() if p.requires_grad]
        statistics = [b for b in model.buffers() if b.is_floating_point()]
        there = torch.tensor([float(p.grad is not None) for p in parameters], device=parameters[0].device)
        gradients = [torch.zeros_like(p) if p.grad is None else p.grad for p in parameters]
        flat = torch.cat([part.flatten().float() for part in (there, *gradients, *statistics)])
        dist.all_reduce(flat)
        flat /= self.count
        shares, *means = flat.split([len(there), *(part.numel() for part in (*gradients, *statistics))])
        for share, parameter, mean in zip(shares.tolist(), parameters, means, strict=False):
            parameter.grad = mean.reshape(parameter.shape).to(parameter.dtype) if share > 0 else None
        for buffer, mean in zip(statistics, means[len(parameters) :], strict=True):
            buffer.copy_(mean.reshape(buffer.shape))

    def mean(self, value: float, device: torch.device) -> float:
        """Mean of a number over all processes, the same in each of them."""
        if self.count == 1:
            return value
        tensor = torch.tensor([value], dtype=torch.float32 if device.type == "mps" else torch.float64, device=device)
        dist.all_reduce(tensor)
        return float(tensor) / self.count

    def wait(self) -> None:
        """Go on when all have come here."""
        if self.count > 1:
            dist.barrier()


def join_processes(device: str) -> Processes:
    """Join those that ``torchrun`` started together; alone without it.

    NCCL between GPUs; gloo on processors, and where several processes share a GPU, which NCCL refuses.
    """
    count = int(os.environ.get("WORLD_SIZE", "1"))
    if count == 1:
        return Processes()
    found = Processes(rank=int(os.environ["RANK"]), count=count, local_rank=int(os.environ.get("LOCAL_RANK", "0")))
    on_this_machine = int(os.environ.get("LOCAL_WORLD_SIZE", str(count)))
    gpus = found.device(device).type == "cuda" and on_this_machine <= torch.cuda.device_count()
    if not dist.is_initialized():
        dist.init_process_group("nccl" if gpus else "gloo")
    return found


def leave_processes() -> None:
    """End what :func:`join_processes` began."""
    if dist.is_initialized():
        dist.destroy_process_group()
