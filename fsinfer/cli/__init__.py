"""The ``fsinfer`` command: it parses, calls and prints; the only place that knows typer and rich."""

from __future__ import annotations


def main() -> None:
    """Entry point of the ``fsinfer`` command."""
    from fsinfer.cli.app import main as run

    run()
