"""What the stages from the photographs to the cloud have to tell: frames, poses, scale, cloud."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from enum import StrEnum
from typing import Any

from fsinfer.notices.numbers import counted, noun

#: Names of photographs that a sentence lists. Source: three lines of a terminal.
MOST_NAMES = 20
#: Rejected frames that a sentence lists with their reasons. Source: two lines of a terminal.
MOST_REASONS = 5


class CaptureCode(StrEnum):
    """Warnings of the stages before the trees, and reasons why a frame was not used."""

    # Frames
    too_dark = "too_dark"
    too_bright = "too_bright"
    blurred = "blurred"
    repeated = "repeated"
    same_picture = "same_picture"
    whole_sphere = "whole_sphere"
    unreadable = "unreadable"
    same_name = "same_name"
    frames_not_used = "frames_not_used"
    names_not_by_time = "names_not_by_time"
    cameras_alternate = "cameras_alternate"
    photos_in_folders = "photos_in_folders"
    photos_not_read = "photos_not_read"
    videos_not_read = "videos_not_read"
    video_cut_short = "video_cut_short"
    # Poses
    photo_of_same_name = "photo_of_same_name"
    photo_unreadable = "photo_unreadable"
    photos_unplaced = "photos_unplaced"
    photos_astray = "photos_astray"
    photos_contradicted = "photos_contradicted"
    photos_loose = "photos_loose"
    parts_joined = "parts_joined"
    part_apart = "part_apart"
    rolling_shutter = "rolling_shutter"
    focal_length_changes = "focal_length_changes"
    lenses_mixed = "lenses_mixed"
    picture_shifts = "picture_shifts"
    # Depth
    views_without_sources = "views_without_sources"
    # Cloud
    no_ground_plane = "no_ground_plane"
    # Scale
    no_scale_given = "no_scale_given"
    no_scale_from_markers = "no_scale_from_markers"
    markers_of_unknown_length = "markers_of_unknown_length"
    one_board = "one_board"
    board_outvoted = "board_outvoted"
    boards_contradict = "boards_contradict"
    printed_length_differs = "printed_length_differs"
    boards_contradict_scale = "boards_contradict_scale"
    board_at_two_places = "board_at_two_places"
    endpoints_of_metric_cloud = "endpoints_of_metric_cloud"
    end_beside_cloud = "end_beside_cloud"
    clicks_do_not_fit = "clicks_do_not_fit"
    unlikely_camera_height = "unlikely_camera_height"
    scale_error_unknown = "scale_error_unknown"


def _frames_not_used(values: Mapping[str, Any]) -> str:
    listed = "; ".join(values["rejected"][:MOST_REASONS])
    count = len(values["rejected"])
    more = count - MOST_REASONS
    return (
        f"{count} of {values['frames']} frames {noun(count, 'was', 'were')} not used "
        f"({listed}{f'; and {more} more' if more > 0 else ''})"
    )


def _shown(names: Sequence[str]) -> str:
    return ", ".join(names[:MOST_NAMES]) + (", ..." if len(names) > MOST_NAMES else "")


def _not_read(values: Mapping[str, Any]) -> str:
    return (
        f"pictures of kinds that are not read ({_shown(values['kinds'])}) were passed over, {values['photos']} in all: "
        "export them as JPEG"
    )


def _spheres(values: Mapping[str, Any]) -> str:
    found = counted(values["videos"], "video", "videos")
    return (
        f"{found} of a camera of the whole sphere ({_shown(values['kinds'])}) {noun(values['videos'], 'was', 'were')} "
        "passed over, since no such lens is known here: take flat photos or videos"
    )


def _in_folders(values: Mapping[str, Any]) -> str:
    found = counted(values["photos"], "photo or video", "photos and videos")
    return (
        f"{found} in folders within it ({_shown(values['names'])}) {noun(values['photos'], 'was', 'were')} not "
        "looked at: put what belongs to the plot into one folder"
    )


def _without_sources(values: Mapping[str, Any]) -> str:
    names = values["names"]
    return (
        f"{len(names)} of {values['views']} views have no source view in pair.txt, and no depth map ({_shown(names)})"
    )


def _left_out(why: str) -> Callable[[Mapping[str, Any]], str]:
    def say(values: Mapping[str, Any]) -> str:
        names = sorted(values["names"])
        return f"{len(names)} of {values['photos']} photos left out ({_shown(names)}): {why}"

    return say


def _parts_joined(values: Mapping[str, Any]) -> str:
    names = sorted(values["names"])
    return (
        f"the walk tore, and {len(names)} photos ({names[0]} to {names[-1]}) were joined to the rest by boards or "
        "photos that both parts have; look at the map where they meet"
    )


def _one_board(values: Mapping[str, Any]) -> str:
    # Older records, of boards by their number alone, do not say where the length is from.
    told = "as given" if values.get("given", False) else "by its number"
    return (
        f"the scale rests on one board (number {values['number']}, {values['length_m']:g} m {told}), and no other "
        "shows whether that is right: measure its black square with a ruler, and put up three or more next time"
    )


def _outvoted(values: Mapping[str, Any]) -> str:
    percent = 100 * values["residual_rel"]
    return (
        f"board {values['number']} comes out {abs(percent):.1f} % {'larger' if percent > 0 else 'smaller'} than the "
        "other boards make it, and does not count: measure its black square with a ruler; it was printed at another "
        "size, or something else was taken for it"
    )


def _contradict(values: Mapping[str, Any]) -> str:
    percent = 100 * values["apart_rel"]
    return (
        f"boards {values['first']} and {values['second']} contradict each other by {percent:.1f} %, and no majority "
        f"tells which is right, so that every DBH may be off by {percent / 2:.1f} %: measure their black squares with "
        "a ruler, and put up three or more next time"
    )


def _printed(values: Mapping[str, Any]) -> str:
    numbers, given_m, printed_m = values["numbers"], values["given_m"], values["printed_m"]
    percent = 100 * abs(given_m / printed_m - 1)
    return (
        f"board{'s' if len(numbers) > 1 else ''} {', '.join(numbers)}: fsinfer marker prints this number with a side "
        f"of {printed_m:g} m, and --aruco-length-m says {given_m:g} m. If the boards are those, every DBH is "
        f"{percent:.0f} % too {'large' if given_m > printed_m else 'small'}: run again without --aruco-length-m"
    )


def _contradict_scale(values: Mapping[str, Any]) -> str:
    numbers, percent = values["numbers"], 100 * values["apart_rel"]
    several = len(numbers) > 1
    size = f"{abs(percent):.1f} % too {'large' if percent > 0 else 'small'}"
    return (
        f"by the length{'s' if several else ''} that board{'s' if several else ''} {', '.join(numbers)} "
        f"tell{'' if several else 's'} by number, the scale that was given makes everything {size}, every DBH too: "
        f"measure {'their black squares' if several else 'its black square'} with a ruler, and look at what was given"
    )


def _alternate(values: Mapping[str, Any]) -> str:
    return (
        f"photos of {' and '.join(values['cameras'])} alternate by name: {values['changes']} of {values['photos']} "
        "follow one of another camera; photos with neighbouring names are taken for neighbours of one walk, so rename "
        "them, with a letter for each camera in front, for each camera's photos to follow each other"
    )


def _two_places(values: Mapping[str, Any]) -> str:
    apart_m = values["apart_m"]
    apart = f"{apart_m:.1f} m" if apart_m >= 0.1 else f"{100 * apart_m:.0f} cm"
    return (
        f"Board {values['number']} was found at two places {apart} apart. Unless two boards have this number, photos "
        f"were placed wrongly, perhaps {values['first']} to {values['last']}, and what is said of the trees cannot be "
        "trusted: take more photos there and on the way there, and turn slowly"
    )


def _unlikely_height(values: Mapping[str, Any]) -> str:
    height_m = values["height_m"]
    shown = f"{height_m:.0f}" if height_m >= 10 else f"{height_m:.2g}"
    hint = "; was the length given in centimetres?" if values["centimetres"] else ""
    return (
        f"with this scale the photos were taken {shown} m above the ground (a phone is held at about "
        f"{values['usual_m']:g} m): the scale, and with it every DBH, is probably wrong; look at the length given{hint}"
    )


#: What each code says: a template that is filled with the notice's values, or a function of them.
SENTENCES: dict[CaptureCode, str | Callable[[Mapping[str, Any]], str]] = {
    CaptureCode.too_dark: "too dark",
    CaptureCode.too_bright: "too bright",
    CaptureCode.blurred: "blurred",
    CaptureCode.repeated: "same as the one before",
    CaptureCode.same_picture: "same picture as {other}",
    CaptureCode.whole_sphere: "shows the whole sphere (360°), and no such lens is known here",
    CaptureCode.unreadable: "cannot be read: {error}",
    CaptureCode.same_name: "same name as {other}",
    CaptureCode.frames_not_used: _frames_not_used,
    CaptureCode.names_not_by_time: (
        "the names of the photos do not follow the walk: by name {backwards} of {photos} were taken before the one "
        "before them; photos with neighbouring names are matched first, so rename them in the order of their times"
    ),
    CaptureCode.cameras_alternate: _alternate,
    CaptureCode.photos_in_folders: _in_folders,
    CaptureCode.photos_not_read: _not_read,
    CaptureCode.videos_not_read: _spheres,
    CaptureCode.video_cut_short: (
        "{name} can be read for {read_s:.0f} of the {length_s:.0f} s that it says it lasts, so that the rest of the "
        "walk is missing; copy it again from the camera"
    ),
    CaptureCode.photo_of_same_name: "{name} was left out: {other} has the same name",
    CaptureCode.photo_unreadable: "left out: {error}",
    CaptureCode.photos_unplaced: _left_out(
        "they could not be placed with the others; more photos between would help, from so far away that both edges of "
        "a stem and the ground are in the picture"
    ),
    CaptureCode.photos_astray: _left_out(
        "the steps between them do not fit the rest of the walk, so they were joined to it by false matches; turn more "
        "slowly, with more photos between"
    ),
    CaptureCode.photos_contradicted: _left_out(
        "most of their matches with other photos speak against where the rest put them; places that look alike were "
        "mixed up; take more photos where the view changes"
    ),
    CaptureCode.photos_loose: _left_out(
        "they share too few points with the other photos for their place to be sure; take more photos where the view "
        "changes, and where the walk comes back to a place"
    ),
    CaptureCode.parts_joined: _parts_joined,
    CaptureCode.part_apart: _left_out(
        "they hang together, but nothing ties them to the rest; put up boards that are seen from both parts, two in "
        "each, or walk on from a place that is in the photos already"
    ),
    CaptureCode.rolling_shutter: (
        "the camera moved while it read out its photos, row by row: in the median photo what it shows moved by "
        "{median_px:.1f} pixels from the first row to the last; that was undone as far as it can be, but stand still "
        "for each photo, and walk and turn more slowly in a video"
    ),
    CaptureCode.focal_length_changes: (
        "the focal length changed by {percent:.2f} % from photo to photo; that was undone, but lock the focus before "
        "the first photo"
    ),
    CaptureCode.lenses_mixed: (
        "the focal length differs by {percent:.1f} % from photo to photo, more than focusing changes it: photos of two "
        "lenses or zooms seem to be mixed without telling so, and every DBH may be wrong by more than it says; "
        "photograph with one lens and do not zoom, and copy the files as they are (messengers take away what photos "
        "tell of their lens)"
    ),
    CaptureCode.picture_shifts: (
        "the middle of the picture shifted by {shift_px:.1f} pixels from photo to photo, as a stabiliser does; that "
        "was undone, but switch digital stabilisation off (that of the lens cannot be, and does little harm)"
    ),
    CaptureCode.views_without_sources: _without_sources,
    CaptureCode.no_ground_plane: (
        "no ground plane found: the lowest points stand for the ground, and breast height may be off; photograph the "
        "ground between the trees as well"
    ),
    CaptureCode.no_scale_given: (
        "no scale was given: the cloud is in model units and no DBH is measured; photograph boards printed by fsinfer "
        "marker, or ArUco markers of your own and give --aruco-length-m, or click the two ends of a known length in "
        "the photos that you have (fsinfer scale OUT --click --length-m), or give --endpoints with --length-m (two "
        "points read off cloud.ply), or --scale"
    ),
    CaptureCode.no_scale_from_markers: (
        "no scale from ArUco markers, the result is in model units and no DBH is measured: {error}"
    ),
    CaptureCode.markers_of_unknown_length: (
        "no scale was given, but ArUco markers are seen (number {numbers}) whose length is not known: measure the "
        "side of the black square and run again with --aruco-length-m, in metres; until then the cloud is in model "
        "units and no DBH is measured"
    ),
    CaptureCode.one_board: _one_board,
    CaptureCode.board_outvoted: _outvoted,
    CaptureCode.boards_contradict: _contradict,
    CaptureCode.printed_length_differs: _printed,
    CaptureCode.boards_contradict_scale: _contradict_scale,
    CaptureCode.board_at_two_places: _two_places,
    CaptureCode.endpoints_of_metric_cloud: (
        "the end points count in the model units of the cloud without a scale, and cloud.ply was in metres before this "
        "run; if they were read off that cloud, the scale is wrong now: give --scale {factor:.6g} instead"
    ),
    CaptureCode.end_beside_cloud: (
        "of the two end points {end} lies beside the cloud, where it has no points, and the other one in it; if a "
        "digit or a sign of it is wrong, so is the scale: read it off again"
    ),
    CaptureCode.clicks_do_not_fit: (
        "the ends that were clicked with fsinfer scale give no scale any more ({error}); click them again"
    ),
    CaptureCode.unlikely_camera_height: _unlikely_height,
    CaptureCode.scale_error_unknown: (
        "the error of a scale given as a number is not known: it is not in the intervals, and one per cent of it is "
        "one per cent of every DBH"
    ),
}
#: Of use to those who look closely, nothing to act upon.
REMARKS: frozenset[CaptureCode] = frozenset({CaptureCode.scale_error_unknown})
#: That no scale is known: said once, by the stage that looked for one.
NO_SCALE: frozenset[CaptureCode] = frozenset(
    {CaptureCode.no_scale_given, CaptureCode.no_scale_from_markers, CaptureCode.markers_of_unknown_length}
)
