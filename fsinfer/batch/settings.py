"""What a batch may use, and where its plots are measured."""

from __future__ import annotations

from dataclasses import dataclass

from fsinfer.errors import InputError


@dataclass(frozen=True, kw_only=True)
class BatchSettings:
    """The defaults suit a laptop: one plot at a time, without limits.

    Attributes
    ----------
    jobs: plots at once on this computer; a cluster has as many as its workers have threads. Source: option.
    retries: how often a plot is tried again that was killed, lost its worker or ran out of memory. Source: option;
        judgement.
    limit_minutes: wall-clock time of one attempt, None for no limit. Source: option.
    limit_gb: resident memory of a plot with all its processes, 10⁹ bytes; None for no limit. Source: option.
    scheduler: address of a Dask scheduler; empty for this computer. Source: option.
    copy: the photographs travel to the worker's own disk, and the results back. Source: option.
    options: of ``fsinfer run`` for every plot, as written on a command line. Source: option.
    threads: cores of each plot; 0 shares those of a computer among the plots that it measures at once. Source: option.
    command: what runs a plot, before photographs and output folder; empty for the installed ``fsinfer run``.
        Source: option.

    Raises
    ------
    InputError
        A number that makes no sense, or copying without a cluster.
    """

    jobs: int = 1
    retries: int = 2
    limit_minutes: float | None = None
    limit_gb: float | None = None
    scheduler: str = ""
    copy: bool = False
    options: tuple[str, ...] = ()
    threads: int = 0
    command: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.jobs < 1 or self.retries < 0 or self.threads < 0:
            msg = f"--jobs {self.jobs}, --retries {self.retries}, --threads {self.threads}: one is too small"
            raise InputError(msg)
        for name, limit in (("--limit-minutes", self.limit_minutes), ("--limit-gb", self.limit_gb)):
            if limit is not None and not limit > 0:
                msg = f"{name} is {limit:g}; give a number above 0, or leave it out for no limit"
                raise InputError(msg)
        if self.copy and not self.scheduler:
            msg = "--copy was given without --scheduler; on this computer the photos are where they are needed already"
            raise InputError(msg)
