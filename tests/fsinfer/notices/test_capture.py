"""What the sentences of the capture advise, and their numbers."""

from __future__ import annotations

from fsinfer.notices.capture import CaptureCode
from fsinfer.notices.notice import notice
from fsinfer.notices.sentences import sentence


def test_one_frame_is_one() -> None:
    one = notice(CaptureCode.frames_not_used, frames=40, rejected=("a: too dark",))
    two = notice(CaptureCode.frames_not_used, frames=40, rejected=("a: too dark", "b: blurred"))
    assert sentence(one) == "1 of 40 frames was not used (a: too dark)"
    assert sentence(two) == "2 of 40 frames were not used (a: too dark; b: blurred)"


def test_who_has_no_scale_is_told_of_the_way_that_needs_no_new_photos() -> None:
    assert "fsinfer scale OUT --click --length-m" in sentence(notice(CaptureCode.no_scale_given))
