"""Constants of finding what is up and where the ground is."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class LevelSettings:
    """Constants of the levelling; lengths are parts of the plot's extent, because the unit is unknown.

    Attributes
    ----------
    max_tilt_deg: the ground's normal and the stems' up lie this near to the cameras' up. Source: people tilt a phone
        down by 20-30 degrees; slopes of forests stay below 35.
    min_second_spread: the x axes of the cameras fix up only if they point in different directions: the second
        eigenvalue of their scatter, as part of the whole. Source: 0.5 for a full circle, 0.03 for a fan of about 20
        degrees.
    stem_window: |n.up| below which a patch may belong to a stem, at first. Source: judgement; 17 degrees.
    blind_window: the same when up is only known from the cameras' downward axes, which pitch biases. Source: judgement;
        27 degrees.
    lean_scale: |n.up| at which a patch counts half (Cauchy weight), so that leaning stems pull little. Source:
        judgement; 3.4 degrees.
    alike: photographs of one walk that are held alike, so that their errors do not average out. Source: judgement.
    usual_roll_deg: by which a photograph is held askew, as a standard deviation; counts as much as ``alike`` of them.
        Source: judgement.
    camera_floor_deg: error of up from however many cameras. Source: judgement; a habit of holding a phone askew
        averages out only where photographs look all round.
    common_lean_deg: by which all stems of a plot lean together, as a standard deviation. Source: judgement; stands on
        creeping slopes and after storms.
    noted_gravity_deg: gravity that a phone noted is off by so much in a single photograph, as a standard deviation: the
        hand moves. Source: 23 photographs of a phone held two ways round, 1.2 degrees from their mean.
    gravity_floor_deg: error of up from however many notes: of the sensor itself. Source: judgement.
    min_noted: photographs that must have noted gravity. Source: judgement.
    max_noted_deg: notes that lie farther apart, in the root mean square, are worth nothing. Source: judgement; such
        poses or such a phone are at odds with themselves.
    contradiction: squared distance of both, in variances of the cameras', beyond which they contradict each other.
        Source: statistics, 99 % of a chi-square with two degrees of freedom.
    min_stem_patches: fewer patches are no evidence for stems. Source: judgement.
    min_gathered: of the patches within three times ``lean_scale`` this part lies within it. Source: isotropic normals
        (foliage) fill any window evenly, a third; around stems they gather at zero.
    roll_scale: sine of the roll at which a camera counts half. Source: judgement; a tenth of a radian, because single
        photographs are taken with the phone turned.
    cells: the ground is sought among the lowest points of so many cells a side. Source: judgement.
    plane_tolerance: distance to the ground plane of what counts as ground, part of the extent. Source: judgement.
    min_ground_part: a plane must hold this part of the cells. Source: judgement.
    """

    max_tilt_deg: float = 35.0
    min_second_spread: float = 0.03
    stem_window: float = 0.3
    blind_window: float = 0.45
    lean_scale: float = 0.06
    alike: float = 4.0
    usual_roll_deg: float = 3.0
    camera_floor_deg: float = 0.7
    common_lean_deg: float = 2.5
    noted_gravity_deg: float = 1.2
    gravity_floor_deg: float = 0.7
    min_noted: int = 4
    max_noted_deg: float = 6.0
    contradiction: float = 9.2
    min_stem_patches: int = 150
    min_gathered: float = 0.45
    roll_scale: float = 0.1
    cells: int = 30
    plane_tolerance: float = 0.01
    min_ground_part: float = 0.2
