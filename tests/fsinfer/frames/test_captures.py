"""What comes off phones: HEIC, clips beside photos, portrait video, uneven frame times, the sheet of the dropped."""

from __future__ import annotations

import shutil
import struct
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.errors import ImageError
from fsinfer.frames.quality import reasons_to_drop, score_frame
from fsinfer.frames.select import CONTACT_SHEET, frame_stems, list_captures, select_frames
from fsinfer.frames.settings import FrameSettings, QualityLimits, VideoSettings
from fsinfer.frames.video import _choose
from fsinfer.frames.view_shift import ViewChange
from fsinfer.io.exif import camera_key, gnss_degrees
from fsinfer.io.images import read_image, write_image
from fsinfer.io.names import sortable
from fsinfer.notices.capture import CaptureCode
from fsinfer.notices.notice import notice
from fsinfer.notices.sentences import sentence
from tests.support.rendered_room import texture


def photo(seed: int) -> NDArray[np.uint8]:
    return texture(seed, 300)[:150, :200]


def write_video(path: Path, frames: list[NDArray[np.uint8]], codec: str = "mp4v") -> None:
    height, width = frames[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), 10.0, (width, height))
    if not writer.isOpened():
        pytest.skip("this OpenCV writes no such video")
    for frame in frames:
        writer.write(np.ascontiguousarray(frame[:, :, ::-1]))
    writer.release()


def test_heic_photos_come_upright_with_lens_and_place(tmp_path: Path) -> None:
    pillow_heif = pytest.importorskip("pillow_heif")
    from PIL import Image

    pillow_heif.register_heif_opener()
    folder = tmp_path / "photos"
    folder.mkdir()
    exif = Image.Exif()
    exif[0x0112] = 1
    exif[0x0110] = "Phone 15"
    exif.get_ifd(0x8769)[0x920A] = 6.86
    exif.get_ifd(0x8825).update({1: "N", 2: (48.0, 30.0, 36.0), 3: "W", 4: (9.0, 0.0, 0.0)})
    for number in range(3):
        Image.fromarray(photo(number)).save(folder / f"IMG_{number}.HEIC", exif=exif.tobytes(), quality=95)
    result = select_frames(folder, tmp_path / "out")
    assert [path.name for path in result.images] == [f"IMG_{number}.jpg" for number in range(3)]
    assert np.abs(read_image(result.images[1]).astype(int) - photo(1)).mean() < 8
    assert camera_key(result.images[0])[3] == "Phone 15"
    assert camera_key(result.images[0])[4] == "6.86"
    assert gnss_degrees(folder / "IMG_0.HEIC") == pytest.approx((48.51, -9.0))
    # The frames are shared and shown: the place stays with the photos.
    assert gnss_degrees(result.images[0]) is None


def test_photos_and_clips_in_one_folder(tmp_path: Path) -> None:
    folder = tmp_path / "day"
    for number in range(4):
        write_image(folder / f"a{number}.jpg", photo(number))
    wide = texture(9, 500)
    write_video(folder / "b.mp4", [wide[:150, 2 * i : 2 * i + 200] for i in range(40)])
    write_video(folder / "c.mp4", [wide[200:350, 2 * i : 2 * i + 200] for i in range(40)])
    (folder / "d.mp4").write_bytes(b"cut off")
    (folder / ".hidden.mp4").write_bytes(b"")
    assert [path.name for path in list_captures(folder)] == [
        *(f"a{i}.jpg" for i in range(4)),
        "b.mp4",
        "c.mp4",
        "d.mp4",
    ]
    result = select_frames(folder, tmp_path / "out", settings=FrameSettings(interval_s=1.0))
    names = [path.stem for path in result.images]
    assert names == sorted(names)
    assert [sum(name.startswith(letter) for name in names) for letter in "abc"] == [4, 4, 4]
    assert [row.reason.split(":")[0] for row in result.rows if row.source == "d.mp4"] == ["cannot be read"]
    # Each clip is a camera of its own; the photos say nothing about theirs and share one.
    keys = {letter: {camera_key(path) for path in result.images if path.stem.startswith(letter)} for letter in "abc"}
    assert [len(keys[letter]) for letter in "abc"] == [1, 1, 1]
    assert len(keys["a"] | keys["b"] | keys["c"]) == 3


@pytest.mark.parametrize(("one", "other"), [("west", "east"), ("запад", "север"), ("Plot Ä", "Plot Ö")])
def test_clips_have_cameras_of_their_own_in_any_letters(tmp_path: Path, one: str, other: str) -> None:
    wide = texture(9, 500)
    (tmp_path / "clips").mkdir()
    for row, name in enumerate((one, other)):
        tile = wide[200 * row : 200 * row + 150]
        write_video(tmp_path / "clips" / f"{name}.avi", [tile[:, 2 * i : 2 * i + 200] for i in range(25)], codec="MJPG")
    result = select_frames(tmp_path / "clips", tmp_path / "out")
    keys = {
        name: {camera_key(path) for path in result.images if path.stem.startswith(name.replace(" ", "_"))}
        for name in (one, other)
    }
    assert [len(keys[name]) for name in (one, other)] == [1, 1]
    assert keys[one] != keys[other]


def test_a_folder_of_clips_alone_and_an_empty_one(tmp_path: Path) -> None:
    (tmp_path / "clips").mkdir()
    write_video(tmp_path / "clips" / "walk.mp4", [texture(1, 400)[:150, 2 * i : 2 * i + 200] for i in range(25)])
    assert len(select_frames(tmp_path / "clips", tmp_path / "out").images) == 2
    (tmp_path / "none").mkdir()
    with pytest.raises(ImageError, match="holds no photos"):
        select_frames(tmp_path / "none", tmp_path / "out2")


def test_pictures_of_kinds_that_are_not_read_are_told_of(tmp_path: Path) -> None:
    for name in ("b.DNG", "c.dng", "d.avif", ".e.dng"):
        (tmp_path / name).write_bytes(b"")
    with pytest.raises(ImageError, match=r"holds no photos .*; export its \.avif, \.dng files as JPEG"):
        select_frames(tmp_path, tmp_path / "out")
    (tmp_path / "f.RAW-02.ORIGINAL.dng").write_bytes(b"")
    (tmp_path / "g.gif").mkdir()
    for number, name in enumerate(("a", "b", "c", "f.RAW-01.COVER")):
        write_image(tmp_path / f"{name}.jpg", photo(number))
    # Of a raw file that lies beside its JPEG nothing is lost.
    (told,) = select_frames(tmp_path, tmp_path / "out").warnings
    assert told == notice(CaptureCode.photos_not_read, kinds=(".avif",), photos=1)
    assert sentence(told) == (
        "pictures of kinds that are not read (.avif) were passed over, 1 in all: export them as JPEG"
    )


def test_a_folder_of_plots_leads_to_the_batch_and_their_videos_are_named(tmp_path: Path) -> None:
    folder = tmp_path / "Flächen"
    for name in ("Plot 1", "Plot 2"):
        (folder / name).mkdir(parents=True)
        (folder / name / "GX010001.MP4").write_bytes(b"")
    with pytest.raises(
        ImageError, match=r"no photos or videos .*\.mp4.* do \(Plot 1, Plot 2\).* fsinfer batch measures"
    ):
        select_frames(folder, tmp_path / "out")
    shutil.rmtree(folder / "Plot 2")
    with pytest.raises(ImageError, match=r"\(Plot 1\), or put all photos of the plot into one$"):
        select_frames(folder, tmp_path / "out")


def test_videos_of_the_whole_sphere_are_told_of(tmp_path: Path) -> None:
    for name in ("VID_1.insv", "GS01.360", ".GS02.360"):
        (tmp_path / name).write_bytes(b"")
    with pytest.raises(ImageError, match=r"its \.360, \.insv files are of a camera of the whole sphere"):
        select_frames(tmp_path, tmp_path / "out")
    for number in range(3):
        write_image(tmp_path / f"a{number}.jpg", photo(number))
    (told,) = select_frames(tmp_path, tmp_path / "out").warnings
    assert told == notice(CaptureCode.videos_not_read, kinds=(".360", ".insv"), videos=2)
    assert sentence(told).startswith("2 videos of a camera of the whole sphere (.360, .insv) were passed over")


def test_photos_of_the_whole_sphere_are_left_out_before_minutes_are_spent_on_them(tmp_path: Path) -> None:
    from PIL import Image

    folder = tmp_path / "photos"
    folder.mkdir()
    packet = b'<x:xmpmeta><rdf:Description GPano:ProjectionType="equirectangular"/></x:xmpmeta>'
    for number in range(3):
        Image.fromarray(photo(number)).save(folder / f"R{number}.jpg", xmp=packet)
    with pytest.raises(ImageError, match=r"none of the 3 photos .* \(shows the whole sphere \(360°\)"):
        select_frames(folder, tmp_path / "out")
    for number in range(4, 7):
        Image.fromarray(photo(number)).save(folder / f"R{number}.jpg", xmp=packet.replace(b"equirectangular", b"flat"))
    assert [path.stem for path in select_frames(folder, tmp_path / "out").images] == ["R4", "R5", "R6"]


@pytest.mark.parametrize("name", ["00001.m2ts", "walk.wmv", "walk.3g2"])
def test_videos_of_older_cameras_are_read(tmp_path: Path, name: str) -> None:
    folder = tmp_path / "card"
    folder.mkdir()
    wide = texture(1, 400)
    write_video(
        folder / name, [wide[:150, 2 * i : 2 * i + 200] for i in range(25)], "WMV2" if "wmv" in name else "mp4v"
    )
    assert len(select_frames(folder, tmp_path / "out").images) >= 2


def test_photos_in_folders_within_are_told_of(tmp_path: Path) -> None:
    folder = tmp_path / "DCIM"
    for name in ("100APPLE", "101APPLE", ".thumbnails", "results", "notes"):
        (folder / name).mkdir(parents=True)
    for number in range(3):
        write_image(folder / "100APPLE" / f"a{number}.jpg", photo(number))
    (folder / "101APPLE" / "walk.mov").write_bytes(b"")
    (folder / "101APPLE" / "._walk.mov").write_bytes(b"")
    (folder / ".thumbnails" / "a.jpg").write_bytes(b"")
    for name in ("plot.json", "evaluation.png"):
        (folder / "results" / name).write_bytes(b"")
    with pytest.raises(ImageError, match=r"give one of those within it that do \(100APPLE, 101APPLE\)"):
        select_frames(folder, tmp_path / "out")
    for number in range(3, 6):
        write_image(folder / f"b{number}.jpg", photo(number))
    # What is put beside the photos is no plot of its own.
    (told,) = select_frames(folder, folder / "notes" / "out").warnings
    assert (told.code, told.values["names"], told.values["photos"]) == (
        CaptureCode.photos_in_folders,
        ("100APPLE", "101APPLE"),
        4,
    )
    assert sentence(told).startswith("4 photos and videos in folders within it (100APPLE, 101APPLE) were not looked at")
    for name in ("100APPLE", "101APPLE"):
        shutil.rmtree(folder / name)
    assert select_frames(folder, tmp_path / "out").warnings == ()


def test_portrait_flag_of_a_video_turns_its_frames(tmp_path: Path) -> None:
    upright = texture(3, 300)[:240, :160]
    path = tmp_path / "portrait.mp4"
    write_video(path, [np.ascontiguousarray(np.rot90(upright, 1))] * 5)
    data = bytearray(path.read_bytes())
    at = data.rindex(b"tkhd") + 4 + 40
    one = 1 << 16
    # The matrix of ISO 14496-12, 8.3.2: a quarter clockwise to show.
    data[at : at + 36] = struct.pack(">9i", 0, one, 0, -one, 0, 0, 160 * one, 0, 1 << 30)
    path.write_bytes(bytes(data))
    frame = read_image(select_frames(path, tmp_path / "out").images[0])
    assert frame.shape == upright.shape
    assert np.abs(frame.astype(int) - upright).mean() < 12
    assert np.abs(frame[::-1, ::-1].astype(int) - upright).mean() > 25


class UnevenClip:
    """A capture whose frames come at given times, as phones record them in poor light."""

    def __init__(self, times_s: list[float]) -> None:
        self.times_s, self.at = times_s, -1

    def grab(self) -> bool:
        self.at += 1
        return self.at < len(self.times_s)

    def get(self, what: int) -> float:
        if what == cv2.CAP_PROP_POS_MSEC:
            return 1000 * self.times_s[min(max(self.at, 0), len(self.times_s) - 1)]
        return {cv2.CAP_PROP_FPS: 30.0, cv2.CAP_PROP_FRAME_COUNT: float(len(self.times_s))}[what]

    def retrieve(self) -> tuple[bool, NDArray[np.uint8]]:
        return True, texture(0, 300)[:150, self.at // 2 : self.at // 2 + 200]


@pytest.mark.parametrize(("share", "told"), [(1.0, False), (0.97, False), (0.5, True)])
def test_a_video_that_was_cut_short_is_told_of(tmp_path: Path, share: float, told: bool) -> None:
    """Half of the walk is missing then; a container whose index is not at its end can be read all the same."""
    wide = texture(3, 900)
    write_video(tmp_path / "whole.avi", [wide[:240, 4 * k : 4 * k + 320] for k in range(100)], codec="MJPG")
    content = (tmp_path / "whole.avi").read_bytes()
    folder = tmp_path / "walk"
    folder.mkdir()
    (folder / "walk.avi").write_bytes(content[: int(share * len(content))])
    result = select_frames(folder, tmp_path / "out")
    cut = [warning for warning in result.warnings if warning.code == CaptureCode.video_cut_short]
    assert bool(cut) is told
    if told:
        assert cut[0].values["name"] == "walk.avi"
        assert cut[0].values["read_s"] == pytest.approx(5.0, abs=0.5)
        assert "of the 10 s" in sentence(cut[0])


def test_uneven_frame_times_count_by_their_stamps() -> None:
    def times() -> Iterator[float]:
        at = 0.0
        for index in range(120):
            yield at
            at += 1 / 30 if index < 60 else 1 / 10

    clip = UnevenClip(list(times()))
    chosen = list(_choose(clip, VideoSettings(), lambda _d, _t, _w: None))  # type: ignore[arg-type]
    # 2 s at 30 frames a second and 6 s at 10: a choice every 2 s, not every 60 frames.
    assert len(chosen) == 4
    for rank, frame in enumerate(chosen):
        assert 2.0 * rank - 1e-6 <= frame.time_s <= 2.0 * rank + 0.5 + 1e-6
        assert frame.time_s == pytest.approx(clip.times_s[frame.index])


def test_a_quick_turn_is_given_more_frames(tmp_path: Path) -> None:
    # Six seconds: slow, then a turn by one and a half pictures in two seconds, then slow.
    wide = texture(5, 600)
    places = np.concatenate([np.arange(20), 20 + 15 * np.arange(20), 320 + np.arange(20)])
    shake = np.random.default_rng(0).integers(0, 4, (60, 2))
    write_video(
        tmp_path / "turn.mp4", [wide[y : y + 150, x : x + 200] for x, y in zip(places, shake[:, 1], strict=True)]
    )
    rows = select_frames(tmp_path / "turn.mp4", tmp_path / "out").rows
    times = [row.time_s for row in rows if row.time_s is not None]
    turning = [time_s for time_s in times if 2.0 <= time_s < 4.2]
    assert len(turning) >= 5
    assert len(times) - len(turning) <= 3
    at = np.interp(times, np.arange(60) / 10, places)
    assert np.diff(at).max() <= 0.3 * 200 + 15


def test_shaking_is_no_way_and_a_cut_is_the_whole_one() -> None:
    wide, change = texture(2, 500), ViewChange()
    assert change.shift(wide[:150, :200]) == 0.0
    change.start(wide[100:250, 100:300])
    rng = np.random.default_rng(1)
    for _ in range(20):
        x, y = rng.integers(90, 111, 2)
        assert change.shift(wide[y : y + 150, x : x + 200]) < 0.08
    for x in range(100, 141, 8):
        far = change.shift(wide[100:250, x : x + 200])
    assert far == pytest.approx(0.2, abs=0.02)
    assert change.shift(texture(77, 300)[:150, :200]) == 1.0
    change.start(np.zeros((150, 200, 3), np.uint8))
    assert change.shift(wide[:150, :200]) == 0.0


def test_the_contact_sheet_shows_each_dropped_frame(tmp_path: Path) -> None:
    folder = tmp_path / "photos"
    for number in range(6):
        write_image(folder / f"p{number}.jpg", photo(number))
    select_frames(folder, tmp_path / "good")
    assert not (tmp_path / "good" / CONTACT_SHEET).exists()
    write_image(folder / "q_dark.jpg", photo(7) // 20)
    write_image(folder / "r_white.jpg", np.full((150, 200, 3), 254, np.uint8))
    (folder / "s_cut.jpg").write_bytes((folder / "p0.jpg").read_bytes()[:2000])
    out = tmp_path / "out"
    select_frames(folder, out)
    sheet = read_image(out / CONTACT_SHEET)
    tiles = [sheet[40 : 40 + 150, 8 + 248 * column : 8 + 248 * column + 200].mean() for column in range(3)]
    assert tiles[0] < 20
    assert tiles[1] > 245
    assert tiles[2] == pytest.approx(205, abs=8)
    # Nothing is dropped any more: the old sheet goes.
    for name in ("q_dark", "r_white", "s_cut"):
        (folder / f"{name}.jpg").unlink()
    select_frames(folder, out)
    assert not (out / CONTACT_SHEET).exists()


def test_a_clip_that_shares_a_name_keeps_its_frames(tmp_path: Path) -> None:
    folder = tmp_path / "day"
    frames = [texture(1, 400)[:150, 2 * i : 2 * i + 200] for i in range(25)]
    folder.mkdir()
    write_video(folder / "IMG_1.mp4", frames)
    write_video(folder / "IMG_1.avi", [frame[::-1] for frame in frames], "MJPG")
    result = select_frames(folder, tmp_path / "out")
    assert len({path.name for path in result.images}) == len(result.images) == 4
    assert {row.source for row in result.rows if row.kept} == {"IMG_1.mp4", "IMG_1.avi"}


def test_a_repetition_is_one_whatever_its_exposure() -> None:
    image = photo(0)
    darker = (image * 0.7).astype(np.uint8)
    scores = [score_frame(one) for one in (image, darker, photo(1))]
    assert reasons_to_drop(scores, QualityLimits()) == [None, notice(CaptureCode.repeated), None]


def test_copies_of_photos_under_other_names_are_left_out(tmp_path: Path) -> None:
    """Both would be source views of others, one witness of their depth that counts as two."""
    folder = tmp_path / "photos"
    for number in range(6):
        write_image(folder / f"IMG_{number}.jpg", photo(number))
    for number in (1, 3):
        shutil.copy(folder / f"IMG_{number}.jpg", folder / f"Copy of IMG_{number}.jpg")
    shutil.copy(folder / "IMG_4.jpg", folder / "Kopie von IMG_4.jpg")
    result = select_frames(folder, tmp_path / "out")
    # The copies go, and not the photos in their places in the walk.
    assert [path.stem for path in result.images] == [f"IMG_{number}" for number in range(6)]
    dropped = {row.source: row.reason for row in result.rows if not row.kept}
    assert dropped == {
        "Copy of IMG_1.jpg": "same picture as IMG_1.jpg",
        "Copy of IMG_3.jpg": "same picture as IMG_3.jpg",
        "Kopie von IMG_4.jpg": "same picture as IMG_4.jpg",
    }


def test_edited_copies_that_a_phone_keeps_beside_the_photos_are_left_out(tmp_path: Path) -> None:
    """They were taken from the same place: to depth and fusion they are a second witness, of nothing new."""
    folder = tmp_path / "photos"
    edited = {1: "IMG_1001-bearbeitet", 2: "IMG_E1002", 3: "IMG_1003~2"}
    for number in range(6):
        image = photo(number)
        write_image(folder / f"IMG_100{number}.jpg", image)
        if number in edited:
            stronger = np.clip(1.5 * (image.astype(float) - 128) + 140, 0, 255).astype(np.uint8)
            write_image(folder / f"{edited[number]}.jpg", stronger)
    # Another phone's photo of that name, and one whose number goes on, are photos of their own.
    write_image(folder / "IMG_1004 (1).jpg", photo(8))
    write_image(folder / "IMG_10040.jpg", photo(9))
    result = select_frames(folder, tmp_path / "out")
    dropped = {row.source: row.reason for row in result.rows if not row.kept}
    assert dropped == {f"{name}.jpg": f"same picture as IMG_100{number}.jpg" for number, name in edited.items()}


def test_the_clips_of_live_photos_are_no_videos(tmp_path: Path) -> None:
    folder = tmp_path / "day"
    wide = texture(1, 400)
    frames = [wide[:150, i : i + 200] for i in range(180)]
    for number in range(3):
        write_image(folder / f"IMG_{number}.JPG", photo(number))
        write_video(folder / f"img_{number}.mov", frames[:30])
    # As long as a walk: somebody's own.
    write_video(folder / "IMG_2.mp4", frames)
    write_video(folder / "other.mov", frames[:30])
    captures = ["IMG_0.JPG", "IMG_1.JPG", "IMG_2.JPG", "IMG_2.mp4", "other.mov"]
    assert [path.name for path in list_captures(folder)] == captures
    result = select_frames(folder, tmp_path / "out")
    assert {row.source for row in result.rows} == set(captures)


def test_photos_are_taken_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    # As Windows names many files at once, and shows them.
    folder = tmp_path / "plot"
    taken = [f"plot ({number}).jpg" for number in range(1, 13)]
    for number, name in enumerate(taken):
        write_image(folder / name, photo(number))
    assert [path.name for path in list_captures(folder)] == taken
    result = select_frames(folder, tmp_path / "out")
    assert [row.source for row in result.rows] == taken
    # Later stages sort by letters.
    assert [row.name for row in result.rows] == [f"plot ({number:02d})" for number in range(1, 13)]
    assert [path.name for path in sorted(result.images)] == [f"plot ({number:02d}).jpg" for number in range(1, 13)]
    assert result.images[11].read_bytes() == (folder / taken[11]).read_bytes()
    assert list(frame_stems(list_captures(folder)).values()) == [path.stem for path in result.images]


@pytest.mark.parametrize(
    ("stems", "expected"),
    [
        (["IMG_0009", "IMG_0010"], ["IMG_0009", "IMG_0010"]),
        (["20231123_081500", "20231123_081500_1"], ["20231123_081500", "20231123_081500_1"]),
        (["a9", "a10", "b3"], ["a09", "a10", "b03"]),
        # They would become one.
        (["a1", "a01", "a10"], ["a1", "a01", "a10"]),
        (["a", "b"], ["a", "b"]),
    ],
)
def test_names_are_filled_up_only_where_letters_have_another_order(stems: list[str], expected: list[str]) -> None:
    assert list(sortable(stems).values()) == expected


def test_hidden_files_beside_clips_are_no_photos(tmp_path: Path) -> None:
    (tmp_path / "clips").mkdir()
    write_video(tmp_path / "clips" / "walk.mp4", [texture(1, 400)[:150, 2 * i : 2 * i + 200] for i in range(25)])
    (tmp_path / "clips" / "._walk.jpg").write_bytes(b"of another system")
    assert [path.name for path in list_captures(tmp_path / "clips")] == ["walk.mp4"]
