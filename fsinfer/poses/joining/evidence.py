"""What speaks for a place of a part, and how much of it is enough."""

from __future__ import annotations

from dataclasses import dataclass

#: A sighting of a board counts as much as so many common points. Source: its four corners, which nothing looks like.
_BOARD_POINTS = 10
#: Of the boards that the part sees, this share of the sightings must agree; and so many of them, where two boards are
#: all that speaks for a place. Source: judgement.
_SIGHTINGS_AGREE, _FEWEST_SIGHTINGS = 0.6, 3
#: Another place may have this share of what speaks for the best one, at most. Source: judgement.
_RIVAL_SHARE = 0.6
#: Common points that bear out a single board, and that are believed alone, in so many photos of each part. Source: by
#: 30 COLMAP places a photo; judgement.
_BEARING_POINTS, _POINTS_ALONE, _FEWEST_PHOTOS = 10, 30, 2


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """What speaks for a place of a part.

    Attributes
    ----------
    boards: numbers most of whose sightings agree. sightings: those that agree; missed: those that do not.
    points: common points that agree; photos: that they are in, of the part with fewer.
    goes_on: whether the walk goes on there; None where it does not tell. ordered: whether the photos follow each other.
    """

    boards: int
    sightings: int
    missed: int
    points: int
    photos: int
    goes_on: bool | None
    ordered: bool = False

    @property
    def score(self) -> int:
        """How much there is, in points."""
        return self.points + _BOARD_POINTS * self.sightings

    @property
    def balance(self) -> int:
        """The same, less the sightings of boards that speak against the place."""
        return self.score - _BOARD_POINTS * self.missed

    def rivals(self, best: Evidence) -> bool:
        """Whether this place, believed too, has nearly as much for it as the best one, so that nobody can tell.

        Of a part whose 52 sightings all agreed, 36 agreed with a place elsewhere, on one board of three: no rival.
        """
        return self.balance > _RIVAL_SHARE * best.balance

    @property
    def possible(self) -> bool:
        """Whether any refinement could make the place one to believe."""
        return self.goes_on is not False or self.boards >= 1

    def enough(self, overlap: bool) -> bool:
        """Whether the place is to be believed; ``overlap``: whether the points of both parts lie on each other."""
        seen = self.sightings + self.missed
        if seen and self.sightings < _SIGHTINGS_AGREE * seen:
            return False
        if self.boards >= 2 and self.sightings >= _FEWEST_SIGHTINGS:
            return True
        borne_out = self.points >= _BEARING_POINTS and self.photos >= _FEWEST_PHOTOS
        if self.boards == 1:
            return overlap or borne_out or self.goes_on is True
        # Trees that look alike have as many points in common as a place: in an ordered walk only those count that put
        # the part where the walk goes on.
        goes_on = self.goes_on is True if self.ordered else self.goes_on is not False
        return self.points >= _POINTS_ALONE and self.photos >= _FEWEST_PHOTOS and goes_on
