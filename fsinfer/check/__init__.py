"""Minutes after capture, from poses and a quick look at the depth: what has to be photographed again."""

from fsinfer.check.capture import CheckSettings, check_capture
from fsinfer.check.result import CheckResult

__all__ = ["CheckResult", "CheckSettings", "check_capture"]
