"""The sub-pixel step: surfaces of known texture seen by exact cameras, a reference written out beside it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.depth import subpixel
from fsinfer.depth.photo_confidence import LastStep
from fsinfer.depth.settings import SubpixelSettings
from fsinfer.depth.subpixel import normalised, refine_depth

Floats = NDArray[np.float64]
HEIGHT, WIDTH, FOCAL = 96, 128, 150.0
BASELINES_M = ((0.25, 0.0), (-0.2, 0.05), (0.1, 0.2))
NO_MEDIAN = replace(SubpixelSettings(), median_px=0)
ONE_STEP = replace(NO_MEDIAN, rounds=1)


@dataclass(frozen=True)
class Plane:
    """A textured plane ``z = depth + tilt x``, x right in metres, in front of the reference camera."""

    depth: float
    tilt: float = 0.0
    seed: int = 0

    def at(self, x: Floats, y: Floats, centre: tuple[float, float] = (0.0, 0.0)) -> tuple[Floats, Floats, Floats]:
        """Point on the plane that pixel (x, y) sees of a camera at ``centre``, which looks along z."""
        u, v = (x - WIDTH / 2) / FOCAL, (y - HEIGHT / 2) / FOCAL
        z = (self.depth + self.tilt * centre[0]) / (1 - self.tilt * u)
        return centre[0] + u * z, centre[1] + v * z, z

    def grey(self, x: Floats, y: Floats) -> Floats:
        """Waves of a few centimetres to a few decimetres, which pixels resolve."""
        rng = np.random.default_rng(self.seed)
        waves = [(*rng.uniform(-1, 1, 2) * 2 * np.pi / 0.12, rng.uniform(0, 2 * np.pi)) for _ in range(12)]
        return np.asarray(np.sum([np.sin(a * x + b * y + c) for a, b, c in waves], axis=0))


def seen(plane: Plane, centre: tuple[float, float]) -> NDArray[np.uint8]:
    x, y = np.meshgrid(np.arange(WIDTH, dtype=np.float64), np.arange(HEIGHT, dtype=np.float64))
    px, py, _ = plane.at(x, y, centre)
    grey = np.clip(128 + 14 * plane.grey(px, py), 0, 255)
    return np.repeat(np.rint(grey).astype(np.uint8)[..., None], 3, axis=2)


def cameras() -> tuple[Floats, Floats]:
    intrinsic = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
    poses = np.tile(np.eye(4), (1 + len(BASELINES_M), 1, 1))
    poses[1:, :2, 3] = -np.array(BASELINES_M)
    return np.tile(intrinsic, (len(poses), 1, 1)), poses


def views(plane: Plane) -> list[NDArray[np.uint8]]:
    return [seen(plane, centre) for centre in ((0.0, 0.0), *BASELINES_M)]


def true_depth(plane: Plane, stride: int) -> NDArray[np.float32]:
    x, y = np.meshgrid(np.arange(0, WIDTH, stride, dtype=np.float64), np.arange(0, HEIGHT, stride, dtype=np.float64))
    return plane.at(x, y)[2].astype(np.float32)


def px_off(found: NDArray[np.float32], truth: NDArray[np.float32]) -> NDArray[np.float64]:
    """Disparity error, pixels of the widest baseline, away from the border."""
    error = FOCAL * np.hypot(*BASELINES_M[0]) * (1.0 / found.astype(np.float64) - 1.0 / truth)
    margin = 24 * truth.shape[1] // WIDTH
    return np.asarray(error[margin:-margin, margin:-margin])


def shifted(truth: NDArray[np.float32], px: float | Floats) -> NDArray[np.float32]:
    """A depth map that many pixels off, at the widest baseline."""
    inverse = 1.0 / truth + px / (FOCAL * np.hypot(*BASELINES_M[0]))
    return np.asarray(1.0 / inverse, np.float32)


def refined(
    depth: NDArray[np.float32],
    images: list[NDArray[np.uint8]],
    settings: SubpixelSettings | None = None,
    confidence: NDArray[np.float32] | None = None,
    threads: int = 1,
) -> NDArray[np.float32]:
    greys = [normalised(image, settings) for image in images]
    sure = np.ones_like(depth) if confidence is None else confidence
    return refine_depth(depth, sure, greys, *cameras(), settings=settings, threads=threads).depth


@pytest.mark.parametrize("stride", [1, 2, 4])
@pytest.mark.parametrize("tilt", [0.0, 0.4])
@pytest.mark.parametrize("px", [0.3, -0.3])
def test_a_surface_a_third_of_a_pixel_off_comes_back(stride: int, tilt: float, px: float) -> None:
    plane = Plane(3.0, tilt)
    truth = true_depth(plane, stride)
    once, twice = (
        px_off(refined(shifted(truth, px), views(plane), replace(SubpixelSettings(), rounds=rounds)), truth)
        for rounds in (1, 2)
    )
    assert np.median(np.abs(once)) < 0.04
    assert np.percentile(np.abs(once), 95) < 0.15
    assert np.median(np.abs(twice)) < 0.02


@pytest.mark.parametrize("stride", [2, 4])
def test_a_smaller_map_moves_as_one_at_full_size_does(stride: int) -> None:
    """Where the error changes from place to place, on photographs whose sides are no multiple of the stride."""
    plane = Plane(3.0, 0.3)
    images = [image[:-1, :-3] for image in views(plane)]
    truth = true_depth(plane, 1)[:-1, :-3]
    wrong = shifted(truth, 0.2 * np.sin(0.15 * np.arange(truth.shape[1])))
    s = replace(ONE_STEP, window_px=4.0)
    start = np.ascontiguousarray(wrong[::stride, ::stride])
    moved = 1 / refined(start, images, s)
    expected = 1 / refined(wrong, images, s)[::stride, ::stride]
    inner = slice(16 // stride, -16 // stride)
    px = FOCAL * np.hypot(*BASELINES_M[0])
    assert np.percentile(px * np.abs(expected - 1 / start), 90) > 0.1
    assert px * np.abs(moved - expected)[inner, inner].max() < 0.03


@pytest.mark.parametrize("stride", [2, 4])
def test_each_step_looks_at_the_half_that_the_other_leaves_out(stride: int) -> None:
    plane = Plane(3.0)
    truth = true_depth(plane, stride)
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    start = shifted(truth, 0.3)
    for colour in (0, 1):
        greys = [normalised(image) for image in views(plane)]
        # Nothing is known of the pixels of the other colour, so that one of two steps has nothing to look at.
        greys[0] = np.where((x + y) % 2 == colour, greys[0], np.float16("nan"))
        found, once = (
            refine_depth(start, np.ones_like(start), greys, *cameras(), settings=s).depth for s in (NO_MEDIAN, ONE_STEP)
        )
        assert np.median(np.abs(px_off(found, truth))) < 0.1
        # The last step looks at the map's own pixels.
        assert (np.median(np.abs(px_off(once, truth))) < 0.1) == (colour == 0)


def last_step(
    plane: Plane, px: float, images: list[NDArray[np.uint8]] | None = None, settings: SubpixelSettings | None = None
) -> LastStep:
    truth = true_depth(plane, 2)
    greys = [normalised(image) for image in images or views(plane)]
    found = refine_depth(
        shifted(truth, px), np.ones_like(truth), greys, *cameras(), settings=settings or ONE_STEP, threads=1
    )
    assert found.last is not None
    return found.last


INNER = np.s_[12:-12, 16:-16]


def test_one_per_cent_of_the_depth_moves_what_the_widest_baseline_says() -> None:
    told = last_step(Plane(3.0), 0.0).px_per_percent
    assert told[INNER] == pytest.approx(0.01 * FOCAL * np.hypot(*BASELINES_M[0]) / 3.0, rel=1e-3)


def test_the_last_step_tells_how_far_it_was() -> None:
    told = last_step(Plane(3.0), 0.2).shift_px
    assert np.median(told[INNER]) == pytest.approx(-0.2, abs=0.04)


def test_grey_values_vary_as_much_in_a_smaller_map() -> None:
    plane = Plane(3.0)
    greys = [normalised(image) for image in views(plane)]
    variance = []
    for stride in (1, 2, 4):
        depth = true_depth(plane, stride)
        told = refine_depth(depth, np.ones_like(depth), greys, *cameras()).last
        assert told is not None
        inner = slice(12 // stride, -12 // stride)
        variance.append(float(np.median(told.variance[inner, inner])))
    # As the grey values themselves do there, which are less their local mean.
    expected = np.mean(greys[0][12:-12, 12:-12].astype(np.float32) ** 2)
    assert variance == pytest.approx([expected] * 3, rel=0.1)


def test_the_misfit_is_small_where_a_source_looks_the_same_and_grows_beside() -> None:
    right, beside = (last_step(Plane(3.0), px).misfit[INNER] for px in (0.0, 1.0))
    assert np.percentile(right, 95) < 0.02
    assert np.median(beside) > 4 * np.median(right)


def test_the_most_alike_source_is_the_one_that_tells() -> None:
    images = views(Plane(3.0))
    other = [*images[:2], np.full_like(images[2], 255), images[3]]
    assert np.percentile(last_step(Plane(3.0), 0.0, other).misfit[INNER], 95) < 0.02


def test_sources_that_show_the_place_are_counted() -> None:
    """A camera 25 cm to the right does not show what the reference sees at its left border, 12.5 pixels wide."""
    sources = last_step(Plane(3.0), 0.0).sources
    assert (sources[INNER] == len(BASELINES_M)).all()
    assert (sources[12:-12, 0] == 1).all()


def test_what_has_more_texture_has_more_information() -> None:
    flat = [
        np.asarray(np.clip(128 + 0.02 * (image.astype(np.float64) - 128), 0, 255), np.uint8)
        for image in views(Plane(3.0))
    ]
    rough, smooth = last_step(Plane(3.0), 0.0), last_step(Plane(3.0), 0.0, flat)
    assert np.median(smooth.texture[INNER]) < 0.5 * np.median(rough.texture[INNER])
    assert np.median(smooth.variance[INNER]) < 0.5 * np.median(rough.variance[INNER])


def test_what_is_right_stays() -> None:
    plane = Plane(3.0, 0.3)
    truth = true_depth(plane, 2)
    assert np.percentile(np.abs(px_off(refined(truth, views(plane)), truth)), 95) < 0.05


def test_no_step_is_longer_than_what_it_may_be() -> None:
    plane = Plane(3.0)
    wrong = shifted(true_depth(plane, 2), 2.0)
    moved = px_off(refined(wrong, views(plane), replace(ONE_STEP, most_px=0.25)), wrong)
    assert np.abs(moved).max() == pytest.approx(0.25, abs=1e-3)


def test_a_wall_without_texture_stays_where_it_is() -> None:
    images = [np.full((HEIGHT, WIDTH, 3), 120, np.uint8) for _ in range(4)]
    noise = np.random.default_rng(1)
    images = [np.clip(image + noise.normal(0, 0.5, image.shape), 0, 255).astype(np.uint8) for image in images]
    depth = true_depth(Plane(3.0), 2)
    assert np.median(np.abs(px_off(refined(depth, images), depth))) < 0.05


def test_a_source_that_shows_something_else_has_no_say() -> None:
    plane = Plane(3.0)
    truth = true_depth(plane, 2)
    images = views(plane)
    images[1] = seen(Plane(3.0, seed=7), BASELINES_M[0])
    error = px_off(refined(shifted(truth, 0.3), images), truth)
    # Without the weight by correlation the median is at 0.2.
    assert np.median(np.abs(error)) < 0.08


def test_exposure_and_contrast_of_a_source_do_not_matter() -> None:
    plane = Plane(3.0)
    truth = true_depth(plane, 2)
    images = views(plane)
    images[1] = np.clip(30 + 0.6 * images[1], 0, 255).astype(np.uint8)
    images[2] = np.clip(1.3 * images[2].astype(float) - 40, 0, 255).astype(np.uint8)
    assert np.median(np.abs(px_off(refined(shifted(truth, 0.3), images), truth))) < 0.05


def test_unsure_neighbours_do_not_pull() -> None:
    """What is half a pixel off and known to be unsure leaves the sure places beside it alone."""
    plane = Plane(3.0)
    truth = true_depth(plane, 2)
    depth, confidence = truth.copy(), np.ones_like(truth)
    depth[:, :32], confidence[:, :32] = shifted(truth, 0.5)[:, :32], 0.0
    error = np.abs(px_off(refined(depth, views(plane), NO_MEDIAN, confidence), truth))
    margin = 24 * truth.shape[1] // WIDTH
    # 0.13 where they do
    assert np.median(error[:, 32 - margin : 34 - margin]) < 0.05


def test_spots_in_one_photograph_count_little() -> None:
    plane = Plane(3.0)
    truth = true_depth(plane, 2)
    errors = []
    for outlier in (1.0, 100.0):
        s = replace(ONE_STEP, outlier=outlier, least_correlation=-1.0)
        found = []
        for seed in range(3, 7):
            images = views(plane)
            images[1][np.random.default_rng(seed).random((HEIGHT, WIDTH)) < 0.03] = 255
            found.append(np.median(np.abs(px_off(refined(truth, images, s), truth))))
        errors.append(np.mean(found))
    assert errors[0] < 0.75 * errors[1]


def test_between_two_surfaces_nothing_flies() -> None:
    """A silhouette stays one, whatever its shape: every place lies on one of the two surfaces."""
    near, far = (true_depth(Plane(z), 2) for z in (2.0, 4.0))
    ragged = np.random.default_rng(2).random(near.shape) < 0.5
    depth = np.where(ragged, near, far)
    found = refined(depth, views(Plane(4.0)))
    assert not ((found > 2.0 * 1.05) & (found < 4.0 * 0.95)).any()


def test_a_place_that_stands_out_follows_its_neighbours() -> None:
    plane = Plane(3.0)
    truth = true_depth(plane, 2)
    depth = truth.copy()
    depth[24, 32] = 2.0
    assert abs(px_off(refined(depth, views(plane)), truth)).max() < 0.5


def test_no_depth_stays_no_depth() -> None:
    depth = true_depth(Plane(3.0), 2)
    depth[10:20, 10:30] = 0
    found = refined(depth, views(Plane(3.0)))
    assert (found[10:20, 10:30] == 0).all()
    assert (found[25:] > 0).all()


def test_threads_and_blocks_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    plane = Plane(3.0, 0.2)
    wrong = shifted(true_depth(plane, 2), 0.3)
    one, two = (refined(wrong, views(plane), threads=threads) for threads in (1, 2))
    np.testing.assert_array_equal(one, two)
    monkeypatch.setattr(subpixel, "BLOCK_PIXELS", 10 * WIDTH // 2)
    np.testing.assert_allclose(refined(wrong, views(plane)), one, rtol=1e-6)


def test_grey_values_are_those_of_any_exposure_and_noise_stays_small() -> None:
    image = seen(Plane(3.0), (0.0, 0.0))
    found = normalised(image)
    darker = normalised(np.rint(20 + 0.6 * image).astype(np.uint8))
    assert np.abs(found - darker).mean() < 0.1
    assert 0.6 < found.std() < 1.2
    flat = np.clip(120 + np.random.default_rng(0).normal(0, 1, (HEIGHT, WIDTH, 1)), 0, 255).repeat(3, axis=2)
    assert normalised(flat.astype(np.uint8)).std() < 0.4


def test_no_rounds_change_nothing() -> None:
    depth = shifted(true_depth(Plane(3.0), 2), 0.3)
    found = refined(depth, views(Plane(3.0)), replace(SubpixelSettings(), rounds=0))
    np.testing.assert_allclose(found, depth, rtol=1e-6)


def bilinear(image: Floats, u: float, v: float) -> float:
    x, y = int(np.floor(u)), int(np.floor(v))
    if not (0 <= x < WIDTH - 1 and 0 <= y < HEIGHT - 1):
        return float("nan")
    a, b = u - x, v - y
    return float(
        (1 - b) * ((1 - a) * image[y, x] + a * image[y, x + 1])
        + b * ((1 - a) * image[y + 1, x] + a * image[y + 1, x + 1])
    )


def reference_shift(depth: Floats, greys: list[Floats], row: int, column: int, s: SubpixelSettings) -> float:
    """Inverse depth of one place after one step, term by term as the module's docstring has it; all confidence is 1."""
    size = int(np.ceil(3 * s.window_px))
    offsets = range(-size, size + 1)
    kernel = np.exp(-0.5 * (np.array(offsets) / s.window_px) ** 2)
    kernel /= kernel.sum()

    def terms(source: int, y: int, x: int) -> tuple[float, float, float, float]:
        """(slope in pixels of the fastest source, difference, speed, greatest speed) at a place."""
        z = 1.0 / depth[y, x]
        speeds = [FOCAL * np.hypot(*b) for b in BASELINES_M]
        move = -FOCAL * np.array(BASELINES_M[source])
        along = move / np.linalg.norm(move)
        u, v = np.array([x, y]) + move * z
        ahead, behind = (
            bilinear(greys[source + 1], *(np.array([u, v]) + side * s.difference_px * along)) for side in (1, -1)
        )
        slope = (ahead - behind) / (2 * s.difference_px) * speeds[source] / max(speeds)
        return slope, greys[0][y, x] - 0.5 * (ahead + behind), speeds[source], max(speeds)

    normal = right = 0.0
    for source in range(len(BASELINES_M)):

        def agreement(y: int, x: int, source: int = source) -> float:
            squares = sum(
                kernel[i] * kernel[j] * terms(source, y + di, x + dj)[1] ** 2
                for i, di in enumerate(offsets)
                for j, dj in enumerate(offsets)
            )
            correlation = 1 - 0.5 * squares
            span = s.full_correlation - s.least_correlation
            return float(np.clip((correlation - s.least_correlation) / span, 0, 1) ** 2)

        # The correlation of the middle stands for that of the window: it changes little within it here.
        agrees = agreement(row, column)
        for i, di in enumerate(offsets):
            for j, dj in enumerate(offsets):
                slope, away, _, _ = terms(source, row + di, column + dj)
                weight = kernel[i] * kernel[j] * min(1.0, s.outlier / max(abs(away), 1e-9)) * agrees
                normal += weight * slope * slope
                right += weight * slope * away
    shift = np.clip(right / (normal + s.damping), -s.most_px, s.most_px)
    fastest = max(FOCAL * np.hypot(*b) for b in BASELINES_M)
    return float(1.0 / depth[row, column] + shift / fastest)


def test_one_step_is_the_sum_of_its_terms() -> None:
    plane = Plane(3.0, 0.2)
    images = views(plane)
    depth = shifted(true_depth(plane, 1), 0.3)
    s = replace(ONE_STEP, window_px=1.5)
    found = refined(depth, images, s)
    greys = [normalised(image, s).astype(np.float64) for image in images]
    unit = FOCAL * np.hypot(*BASELINES_M[0])
    for row, column in [(48, 64), (40, 70), (55, 50)]:
        expected = reference_shift(depth.astype(np.float64), greys, row, column, s)
        start = 1.0 / depth[row, column]
        assert unit * abs(expected - start) > 0.1
        # OpenCV reads between pixels in steps of 1/32.
        assert unit * abs(1.0 / found[row, column] - expected) < 0.02
