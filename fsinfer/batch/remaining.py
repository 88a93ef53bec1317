"""How long a batch will still take."""

from __future__ import annotations


class RemainingPlots:
    """Learns what a plot takes from those that were measured now; those that were done before tell nothing."""

    def __init__(self) -> None:
        self._seconds = 0.0
        self._plots = 0

    def add(self, seconds: float) -> None:
        """A plot took so long, with all its attempts."""
        self._seconds += seconds
        self._plots += 1

    def seconds(self, left: int, at_once: int) -> float | None:
        """Of ``left`` plots, ``at_once`` at a time; None as long as nothing can be said."""
        if not self._plots:
            return None
        rounds = -(-left // max(1, at_once)) if left <= 2 * at_once else left / max(1, at_once)
        return self._seconds / self._plots * rounds
