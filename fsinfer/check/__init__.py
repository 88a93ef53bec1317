"""Minutes after capture, from poses and a quick look at the depth: what has to be photographed again."""

from fsinfer.check.result import CheckResult
from fsinfer.check.run import CheckSettings, check_capture

__all__ = ["CheckResult", "CheckSettings", "check_capture"]
