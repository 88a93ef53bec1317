"""``report.html``: everything a run found, in one file that needs no network."""

from fsinfer.report.build import make_report

__all__ = ["make_report"]
