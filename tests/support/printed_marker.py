"""A printed marker as a camera takes it: blurred in light or after its tone curve, seen askew."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from fsinfer.scale.detection import predefined_dictionary

_CELL, _RIM, _FINE = 40, 60, 8


def marker_photo(
    number: int, side_px: float, rng: np.random.Generator, *, blur_px: float, gamma: float = 1.0
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Picture (H, W), and the true corners (4, 2) of the black square, pixel centres at integers.

    ``gamma`` over 1: what is blurred is light, and the tone curve follows; 1 blurs the picture itself.
    """
    dictionary = predefined_dictionary("4X4_50")
    side = _CELL * (dictionary.markerSize + 2)
    cells = cv2.aruco.generateImageMarker(dictionary, number, side, borderBits=1)
    light = (0.08 + 0.75 * np.pad(cells, _RIM, constant_values=255).astype(np.float64) / 255) ** gamma
    size = int(1.8 * side_px) + 24
    turn, yaw = rng.uniform(-0.3, 0.3), rng.uniform(-0.6, 0.6)
    linear = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]) @ np.diag([np.cos(yaw), 1.0])
    linear *= side_px / side * _FINE
    middle = size * _FINE / 2 + rng.uniform(-_FINE, _FINE, 2)
    motion = np.column_stack([linear, middle - linear @ np.full(2, (side + 2 * _RIM) / 2)])
    white = float(light[0, 0])
    fine = cv2.warpAffine(light, motion, (size * _FINE, size * _FINE), flags=cv2.INTER_LINEAR, borderValue=white)
    seen = cv2.GaussianBlur(fine.reshape(size, _FINE, size, _FINE).mean(axis=(1, 3)), (0, 0), blur_px)
    picture = 255 * seen ** (1 / gamma) + rng.normal(0, 1.5, seen.shape)
    ends = np.array([[0, 0], [side, 0], [side, side], [0, side]]) + _RIM - 0.5
    corners = (np.column_stack([ends, np.ones(4)]) @ motion.T + 0.5) / _FINE - 0.5
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8), corners
