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


def test_one_photo_in_a_folder_is_one() -> None:
    one = sentence(notice(CaptureCode.photos_in_folders, photos=1, names=("b",)))
    assert one.startswith("1 photo or video in folders within it (b) was not looked at")
    two = sentence(notice(CaptureCode.photos_in_folders, photos=2, names=("b", "c")))
    assert two.startswith("2 photos and videos in folders within it (b, c) were not looked at")


def test_who_has_no_scale_is_told_of_the_way_that_needs_no_new_photos() -> None:
    assert "fsinfer scale OUT --click --length-m" in sentence(notice(CaptureCode.no_scale_given))
