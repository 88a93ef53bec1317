"""Usable photos and video frames are kept, the others have a reason."""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from fsinfer.errors import ImageError, OutputError
from fsinfer.frames.quality import equalize, reasons_to_drop, score_frame
from fsinfer.frames.select import select_frames
from fsinfer.frames.settings import FrameSettings, QualityLimits
from fsinfer.io.images import read_image, write_image
from fsinfer.notices.sentences import sentence
from tests.support.rendered_room import texture


def photo(seed: int, width: int = 200, height: int = 150) -> NDArray[np.uint8]:
    return texture(seed, 300)[:height, :width]


def blurred(image: NDArray[np.uint8], pixels: int) -> NDArray[np.uint8]:
    """Motion blur along the rows."""
    return np.asarray(cv2.filter2D(image, -1, np.full((1, pixels), 1 / pixels, np.float32)), np.uint8)


@pytest.fixture
def photos(tmp_path: Path) -> Path:
    folder = tmp_path / "photos"
    for index in range(8):
        write_image(folder / f"p{index}.jpg", photo(index))
    return folder


def reasons(out: Path) -> dict[str, str]:
    with (out / "frames.csv").open(encoding="utf-8", newline="") as stream:
        return {row["name"]: row["reason"] for row in csv.DictReader(stream) if row["kept"] == "0"}


def test_good_photos_are_all_kept_as_they_are(photos: Path, tmp_path: Path) -> None:
    result = select_frames(photos, tmp_path / "out")
    assert [path.name for path in result.images] == [f"p{index}.jpg" for index in range(8)]
    assert not result.warnings
    for path in result.images:
        assert path.read_bytes() == (photos / path.name).read_bytes()
    header = (tmp_path / "out" / "frames.csv").read_text(encoding="utf-8").splitlines()[0]
    assert header == "name,source,time_s,sharpness,mean_luminance,dark_share,bright_share,kept,reason"


def test_each_bad_photo_has_its_reason(photos: Path, tmp_path: Path) -> None:
    write_image(photos / "q_blurred.jpg", blurred(photo(20), 15))
    write_image(photos / "q_dark.jpg", photo(21) // 20)
    write_image(photos / "q_bright.jpg", np.full((150, 200, 3), 254, np.uint8))
    write_image(photos / "q_pale.png", 238 + photo(24) // 30)  # no pixel is white, and all of them nearly
    write_image(photos / "q_good.jpg", photo(22))
    write_image(photos / "q_good_again.jpg", photo(22), quality=80)
    data = (photos / "p0.jpg").read_bytes()
    (photos / "q_cut.jpg").write_bytes(data[: len(data) // 2])
    write_image(photos / "p0.png", photo(23))
    result = select_frames(photos, tmp_path / "out")
    found = {row.source: row.reason for row in result.rows if not row.kept}
    assert found.pop("q_cut.jpg").startswith("cannot be read")
    assert found == {
        "q_blurred.jpg": "blurred",
        "q_dark.jpg": "too dark",
        "q_bright.jpg": "too bright",
        "q_pale.png": "too bright",
        "q_good_again.jpg": "same as the one before",
        "p0.png": "same name as p0.jpg",
    }
    assert {path.stem for path in (tmp_path / "out" / "images").iterdir()} == {f"p{i}" for i in range(8)} | {"q_good"}
    assert "7 of 16 frames were not used" in sentence(result.warnings[0])


@pytest.mark.parametrize("value", [0, 120])
def test_a_strip_among_the_photos_is_not_the_end(photos: Path, tmp_path: Path, value: int) -> None:
    """Left there by another program: no photo, and looked at like one, whether it is kept or shown on the sheet."""
    write_image(photos / "strip.png", np.full((1, 3000, 3), value, np.uint8))
    result = select_frames(photos, tmp_path / "out")
    assert {f"p{index}" for index in range(8)} <= {row.name for row in result.rows if row.kept}
    assert "strip" in {row.name for row in result.rows}


def test_never_more_than_a_share_is_called_blurred() -> None:
    # Half of a set out of focus by intent (near bark) must not lose the walk.
    scores = [score_frame(photo(i)) for i in range(12)] + [score_frame(blurred(photo(20 + i), 21)) for i in range(8)]
    dropped = [i for i, reason in enumerate(reasons_to_drop(scores, QualityLimits(min_robust_z=0.0))) if reason]
    assert len(dropped) <= 4
    assert all(index >= 12 for index in dropped)


def soft(seed: int, pixels: int = 5) -> NDArray[np.uint8]:
    """As the lens and the processing of another phone make it."""
    return np.asarray(cv2.GaussianBlur(photo(seed), (0, 0), pixels / 3), np.uint8)


def test_a_softer_second_phone_is_not_blurred(tmp_path: Path) -> None:
    def write(name: str, image: NDArray[np.uint8], model: str) -> None:
        exif = Image.Exif()
        exif[0x0110] = model
        write_image(tmp_path / "photos" / f"{name}.jpg", image, exif=exif.tobytes())

    for index in range(60):
        write(f"a{index:02d}", photo(index), "Sharp")
    for index in range(11):
        write(f"b{index:02d}", soft(100 + index), "Soft")
    write("b11", blurred(soft(111), 15), "Soft")
    # Held upright; its lens is the same one, and it is as sharp.
    write("b12", np.ascontiguousarray(np.rot90(soft(112))), "Soft")
    # One photo tells nothing of its phone, and is judged as any.
    write("c00", soft(120, 9), "Another")
    result = select_frames(tmp_path / "photos", tmp_path / "out")
    assert reasons(tmp_path / "out") == {"b11": "blurred", "c00": "blurred"}
    assert len(result.images) == 72


def test_one_camera_is_judged_as_if_none_were_named() -> None:
    scores = [score_frame(photo(i)) for i in range(15)] + [score_frame(soft(20 + i)) for i in range(9)]
    limits = QualityLimits()
    unnamed = reasons_to_drop(scores, limits)
    # A share of all is dropped, and this many it takes with.
    assert sum(reason is not None for reason in unnamed) == 4
    assert reasons_to_drop(scores, limits, ["one"] * 24) == unnamed
    # So is a set of cameras that took few photographs each: theirs are compared with all.
    assert reasons_to_drop(scores, limits, [index // 5 for index in range(24)]) == unnamed
    # With enough of its own the second one is judged by these alone.
    more = [*scores, score_frame(soft(30))]
    assert reasons_to_drop(more, limits, ["one"] * 15 + ["other"] * 10) == [None] * 25


def test_sharpness_falls_with_blur_and_not_with_contrast() -> None:
    image = photo(3)
    sharp = score_frame(image).sharpness
    falling = [score_frame(blurred(image, pixels)).sharpness for pixels in (3, 5, 9, 15)]
    assert [sharp, *falling] == sorted([sharp, *falling], reverse=True)
    assert falling[-1] < 0.3 * sharp
    pale = (128 + 0.4 * (image.astype(float) - 128)).astype(np.uint8)
    assert 0.8 < score_frame(pale).sharpness / sharp < 1.25


def test_photos_on_their_side_are_written_upright_with_the_focal_length(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[0x0112] = 6
    exif.get_ifd(0x8769)[0xA405] = 27
    (tmp_path / "photos").mkdir()
    for index in range(2):
        stored = np.ascontiguousarray(np.rot90(photo(index), 1))
        Image.fromarray(stored).save(tmp_path / "photos" / f"p{index}.jpg", exif=exif.tobytes(), quality=95)
    result = select_frames(tmp_path / "photos", tmp_path / "out")
    with Image.open(result.images[0]) as image:
        assert image.size == (200, 150)
        assert 0x0112 not in image.getexif()
        assert image.getexif().get_ifd(0x8769)[0xA405] == 27
    assert np.abs(read_image(result.images[0]).astype(int) - photo(0)).mean() < 8


def test_sizes_may_be_mixed_and_png_becomes_jpg(photos: Path, tmp_path: Path) -> None:
    write_image(photos / "tall.png", photo(30, 120, 180))
    result = select_frames(photos, tmp_path / "out")
    assert len(result.images) == 9
    assert read_image(tmp_path / "out" / "images" / "tall.jpg").shape == (180, 120, 3)


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
@pytest.mark.parametrize("turned", [False, True])
def test_large_photos_are_written_reduced_with_the_focal_length(tmp_path: Path, suffix: str, turned: bool) -> None:
    exif = Image.Exif()
    exif[0x0112] = 6 if turned else 1
    exif.get_ifd(0x8769)[0xA405] = 27
    large = cv2.resize(photo(0), (800, 600), interpolation=cv2.INTER_NEAREST)
    stored = np.ascontiguousarray(np.rot90(large, 1) if turned else large)
    (tmp_path / "photos").mkdir()
    Image.fromarray(np.asarray(stored, np.uint8)).save(tmp_path / "photos" / f"p{suffix}", exif=exif, quality=95)
    write_image(tmp_path / "photos" / "small.jpg", photo(1))
    result = select_frames(tmp_path / "photos", tmp_path / "out", settings=FrameSettings(longest_px=240))
    assert [path.name for path in result.images] == ["p.jpg", "small.jpg"]
    assert result.images[1].read_bytes() == (tmp_path / "photos" / "small.jpg").read_bytes()
    assert np.abs(read_image(result.images[0]).astype(int) - photo(0)).mean() < 4
    with Image.open(result.images[0]) as image:
        assert image.getexif().get_ifd(0x8769)[0xA405] == 27


@pytest.mark.parametrize("method", ["clahe", "hist"])
def test_equalization_widens_the_luminance_and_keeps_the_tone(method: str) -> None:
    image = (90 + 0.2 * (photo(1).astype(float) - 128)).astype(np.uint8)
    even = equalize(image, method)
    assert even.mean(axis=2).std() > 1.5 * image.mean(axis=2).std()
    grey = np.repeat(image.mean(axis=2, keepdims=True), 3, axis=2).astype(np.uint8)
    assert np.ptp(equalize(grey, method).astype(int), axis=2).max() <= 2


def test_equalized_frames_are_written(photos: Path, tmp_path: Path) -> None:
    result = select_frames(photos, tmp_path / "out", settings=FrameSettings(equalize="hist"))
    written = read_image(result.images[0])
    assert np.abs(written.astype(int) - equalize(photo(0), "hist")).mean() < 8
    with pytest.raises(ImageError, match="magic"):
        select_frames(photos, tmp_path / "other", settings=FrameSettings(equalize="magic"))


def test_another_choice_replaces_the_first(photos: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert len(select_frames(photos, out).images) == 8
    (photos / "p5.jpg").unlink()
    assert len(select_frames(photos, out).images) == 7
    assert not (out / "images" / "p5.jpg").exists()


def test_frames_of_a_choice_that_was_stopped_are_replaced(photos: Path, tmp_path: Path) -> None:
    def stop(done: int, total: int, _what: str) -> None:
        if done == total - 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        select_frames(photos, tmp_path / "out", progress=stop)
    assert any((tmp_path / "out" / "images").iterdir())
    assert len(select_frames(photos, tmp_path / "out").images) == 8


def test_folders_of_the_user_are_not_touched(photos: Path, tmp_path: Path) -> None:
    photos.rename(tmp_path / "images")
    with pytest.raises(ImageError, match="overwritten"):
        select_frames(tmp_path / "images", tmp_path)
    write_image(tmp_path / "others" / "a.jpg", photo(0))
    with pytest.raises(OutputError, match="did not make"):
        select_frames(tmp_path / "others", tmp_path)
    assert len(list((tmp_path / "images").iterdir())) == 8


def test_other_files_of_the_output_folder_stay(photos: Path, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "notes.txt").write_text("plot 7", encoding="utf-8")
    for _ in range(2):
        assert len(select_frames(photos, tmp_path / "out").images) == 8
    assert (tmp_path / "out" / "notes.txt").read_text(encoding="utf-8") == "plot 7"


def test_nothing_usable(tmp_path: Path) -> None:
    folder = tmp_path / "photos"
    for name in ("a", "b"):
        write_image(folder / f"{name}.jpg", np.zeros((60, 80, 3), np.uint8))
    with pytest.raises(ImageError, match="too dark"):
        select_frames(folder, tmp_path / "out")
    assert reasons(tmp_path / "out") == {"a": "too dark", "b": "too dark"}
    for path in folder.iterdir():
        path.write_bytes(b"this is no photograph")
    with pytest.raises(ImageError, match=r"a\.jpg"):
        select_frames(folder, tmp_path / "out2")


def test_sources_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(ImageError, match="does not exist"):
        select_frames(tmp_path / "gone", tmp_path / "out")
    (tmp_path / "empty").mkdir()
    with pytest.raises(ImageError, match="holds no photos"):
        select_frames(tmp_path / "empty", tmp_path / "out")
    (tmp_path / "walk.mp4").write_bytes(b"this is no video")
    with pytest.raises(ImageError, match=r"walk\.mp4"):
        select_frames(tmp_path / "walk.mp4", tmp_path / "out")


def write_video(path: Path, frames: list[NDArray[np.uint8]], rate: float) -> None:
    height, width = frames[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), rate, (width, height))
    if not writer.isOpened():
        pytest.skip("this OpenCV writes no video")
    for frame in frames:
        writer.write(np.ascontiguousarray(frame[:, :, ::-1]))
    writer.release()


@pytest.mark.parametrize("sharp", [{2, 22, 41}, {2, 22, 47}])
def test_video_gives_the_sharpest_frame_of_every_interval(tmp_path: Path, sharp: set[int]) -> None:
    # 10 frames a second, all blurred but three; a window is half a second, and waits as long again for a sharp frame.
    wide = texture(0, 400)
    frames = [wide[100:250, 2 * i : 2 * i + 200] for i in range(50)]
    frames = [frame if i in sharp else blurred(frame, 7) for i, frame in enumerate(frames)]
    write_video(tmp_path / "my walk.avi", frames, 10.0)
    result = select_frames(tmp_path / "my walk.avi", tmp_path / "out", settings=FrameSettings(interval_s=2.0))
    assert [path.name for path in result.images] == [f"my_walk_{i:06d}.jpg" for i in sorted(sharp)]
    assert [row.time_s for row in result.rows] == pytest.approx([i / 10 for i in sorted(sharp)], abs=0.06)
    assert np.abs(read_image(result.images[1]).astype(int) - frames[22]).mean() < 6


def test_large_frames_of_a_video_are_written_reduced(tmp_path: Path) -> None:
    write_video(tmp_path / "wide.avi", [photo(index, 240, 160) for index in range(2)], 1.0)
    result = select_frames(
        tmp_path / "wide.avi", tmp_path / "out", settings=FrameSettings(interval_s=1.0, longest_px=120)
    )
    assert {read_image(path).shape for path in result.images} == {(80, 120, 3)}


def test_standing_still_gives_one_frame(tmp_path: Path) -> None:
    write_video(tmp_path / "still.avi", [photo(0)] * 30, 10.0)
    result = select_frames(tmp_path / "still.avi", tmp_path / "out", settings=FrameSettings(interval_s=1.0))
    assert len(result.images) == 1
    assert len(result.rows) == 3
    assert len(list((tmp_path / "out" / "images").iterdir())) == 1


def test_interval_that_is_none(tmp_path: Path) -> None:
    write_video(tmp_path / "a.avi", [photo(0)] * 3, 10.0)
    with pytest.raises(ImageError, match="interval"):
        select_frames(tmp_path / "a.avi", tmp_path / "out", settings=FrameSettings(interval_s=0.0))
