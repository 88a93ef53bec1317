"""The ArUco markers of one dictionary in all photographs of a scene: looked for once, whatever their length."""

from __future__ import annotations

from dataclasses import dataclass

from fsinfer.io.images import luminance
from fsinfer.progress import Progress, silent
from fsinfer.scale.blooming import bloom_of
from fsinfer.scale.detection import at_their_edges, detect_markers, make_detector, predefined_dictionary
from fsinfer.scale.markers_seen import read_markers_seen
from fsinfer.scale.printed_boards import DICTIONARY
from fsinfer.scale.square_fit import MarkerSettings, Sighting
from fsinfer.scene import Scene, read_view_image
from fsinfer.threads import in_order, photo_threads


@dataclass(frozen=True, kw_only=True)
class SeenMarkers:
    """What was found: every detection in the order of the views, in corners not yet freed of blooming."""

    dictionary: str
    sightings: tuple[Sighting, ...]


def are_known(scene: Scene, dictionary: str = DICTIONARY, settings: MarkerSettings | None = None) -> bool:
    """Whether the poses stage told where markers of ``dictionary`` are, so that a look for them takes no time."""
    known, least = read_markers_seen(scene), (settings or MarkerSettings()).min_side_px
    return any(known.of(view.name, dictionary, least) is not None for view in scene.views)


def look_for_markers(
    scene: Scene,
    *,
    dictionary: str = DICTIONARY,
    settings: MarkerSettings | None = None,
    progress: Progress = silent,
) -> SeenMarkers:
    """Look for the markers of ``dictionary`` (such as ``4X4_50``) in the images of ``scene``.

    Where the poses stage told where they are, their corners alone are.

    Raises
    ------
    ScaleError
        The dictionary is unknown.
    ImageError
        A scene image cannot be read.
    """
    settings = settings or MarkerSettings()
    printed = predefined_dictionary(dictionary)
    known = read_markers_seen(scene)

    def look(index: int) -> list[Sighting]:
        view = scene.views[index]
        places = known.of(view.name, dictionary, settings.min_side_px)
        if places == ():
            return []
        pixels = read_view_image(view)
        grey = luminance(pixels)
        if places is None:
            # OpenCV does not say that a detector may be shared between threads; making one takes no time.
            found = detect_markers(pixels, make_detector(dictionary), min_side_px=settings.min_side_px)
        else:
            found = at_their_edges(grey, places, min_side_px=settings.min_side_px)
        return [
            Sighting(
                marker_id=number,
                view=index,
                corners_px=corners_px,
                bloom_px=bloom_of(grey, corners_px, number, printed),
            )
            for number, corners_px in found
        ]

    sightings: list[Sighting] = []
    for done, seen in enumerate(in_order(look, range(len(scene.views)), photo_threads())):
        progress(done, len(scene.views), "looking for markers")
        sightings += seen
    progress(len(scene.views), len(scene.views), "looking for markers")
    return SeenMarkers(dictionary=dictionary, sightings=tuple(sightings))
