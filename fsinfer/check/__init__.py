"""Minutes after capture, from poses and sparse points alone: what has to be photographed again."""

from fsinfer.check.capture import CheckResult, CheckSettings, check_capture

__all__ = ["CheckResult", "CheckSettings", "check_capture"]
