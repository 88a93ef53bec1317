"""Training samples from any scenes with true depth (:mod:`training.data.find`)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import IterableDataset

from fsinfer.errors import SceneError
from fsinfer.io.pfm import read_pfm
from fsinfer.scene import Scene
from training.data.find import find_true_scenes
from training.data.true_scene import TrueScene

#: Share of a view's pixels that have a true depth, at least, for it to be a sample. Source: judgement.
LEAST_KNOWN = 0.1


@dataclass(frozen=True, kw_only=True)
class Sample:
    """One reference view with its sources, and its true depth.

    Attributes
    ----------
    images: (N, 3, H, W) float32 RGB 0 … 255, view 0 is the reference.
    intrinsics: (N, 3, 3); cam_from_world: (N, 4, 4).
    depth: (H, W) float32, z depth, 0 where unknown.
    depth_range: near, far.
    name: scene and view, for messages.
    """

    images: Tensor
    intrinsics: Tensor
    cam_from_world: Tensor
    depth: Tensor
    depth_range: tuple[float, float]
    name: str


@dataclass(frozen=True, kw_only=True)
class SamplingSettings:
    """How samples vary from one visit of a view to the next.

    Attributes
    ----------
    min_sources, max_sources: views beside the reference. Source: what the depth stage takes.
    colour_jitter: share by which brightness and colours vary. Source: judgement.
    range_jitter: near bound down to 1/(1+j), far bound up to 1+2j of the camera file's. Source: judgement.
    near_pull: half of the samples: near bound drawn in by up to this factor more, as a twig may do. Source: judgement.
    mirror: share of samples seen in a mirror. Source: judgement.
    turn: share of samples with all pictures on their side, as phones held upright often store them. Source: judgement.
    pose_noise_px: half of the samples: each source off by up to this (standard deviation). Source: what structure from
        motion leaves.
    """

    min_sources: int = 2
    max_sources: int = 4
    colour_jitter: float = 0.2
    range_jitter: float = 0.35
    near_pull: float = 6.0
    mirror: float = 0.5
    turn: float = 0.3
    pose_noise_px: float = 0.3


def load_sample(scene: Scene, index: int, sources: Sequence[int], depth: NDArray[np.float32] | None = None) -> Sample:
    """Read view ``index`` with the given source views; a smaller depth map is spread by its integer factor.

    ``depth`` is that of :meth:`training.data.true_scene.TrueScene.true_depth`; without it ``depths/NAME.pfm`` is read.
    """
    views = [scene.views[i] for i in (index, *sources)]
    images = []
    for view in views:
        image = cv2.imread(str(view.image_path), cv2.IMREAD_COLOR)
        if image is None:
            msg = f"{view.image_path} cannot be read as an image; write the scene again"
            raise SceneError(msg)
        images.append(image[..., ::-1].transpose(2, 0, 1).astype(np.float32))
    if len({image.shape for image in images}) > 1:
        msg = f"{scene.folder}: training needs views of one size, found {sorted({i.shape for i in images})}"
        raise SceneError(msg)
    if depth is None:
        depth = read_pfm(scene.folder / "depths" / f"{views[0].name}.pfm")
    height, width = images[0].shape[1:]
    if depth.shape != (height, width):
        factor = height // depth.shape[0]
        depth = depth.repeat(factor, axis=0).repeat(factor, axis=1)[:height, :width]
        if depth.shape != (height, width):
            msg = f"{scene.folder}: depth map {depth.shape} does not fit the image {(height, width)}"
            raise SceneError(msg)
    cameras = [view.camera for view in views]
    return Sample(
        images=torch.from_numpy(np.stack(images)),
        intrinsics=torch.from_numpy(np.stack([c.intrinsic for c in cameras])),
        cam_from_world=torch.from_numpy(np.stack([c.cam_from_world for c in cameras])),
        depth=torch.from_numpy(depth),
        depth_range=(cameras[0].depth_min, cameras[0].depth_max),
        name=f"{scene.folder.name}/{views[0].name}",
    )


def jitter_colour(images: Tensor, strength: float, rng: np.random.Generator) -> Tensor:
    """Gain, offset, gamma and white balance of each view by itself, as automatic phone exposure does."""
    count = len(images)
    unit = (images / 255).clamp(0, 1)

    def draw(*shape: int) -> Tensor:
        return torch.from_numpy(rng.normal(0, strength, shape)).float()

    unit = unit ** torch.exp(draw(count, 1, 1, 1))
    unit = unit * torch.exp(draw(count, 1, 1, 1) + 0.3 * draw(count, 3, 1, 1)) + 0.1 * draw(count, 1, 1, 1)
    return unit.clamp(0, 1) * 255


def mirrored(sample: Sample) -> Sample:
    """Reflect the sample at the plane x = 0 of the world: images and depth left to right, cameras to match."""
    flip = torch.diag(torch.tensor([-1.0, 1.0, 1.0, 1.0], dtype=sample.cam_from_world.dtype))
    intrinsics = sample.intrinsics.clone()
    intrinsics[:, 0, 2] = sample.images.shape[-1] - 1 - intrinsics[:, 0, 2]
    return replace(
        sample,
        images=sample.images.flip(-1),
        depth=sample.depth.flip(-1),
        intrinsics=intrinsics,
        cam_from_world=flip @ sample.cam_from_world @ flip,
    )


def turned(sample: Sample, *, clockwise: bool) -> Sample:
    """Turn all pictures, and the cameras with them, by 90 degrees; the world stays."""
    sign = 1 if clockwise else -1
    turn = torch.tensor([[0.0, -sign, 0, 0], [sign, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]).to(sample.cam_from_world)
    height, width = sample.images.shape[-2:]
    old, intrinsics = sample.intrinsics, sample.intrinsics.clone()
    intrinsics[:, 0, 0], intrinsics[:, 1, 1] = old[:, 1, 1], old[:, 0, 0]
    intrinsics[:, 0, 2] = height - 1 - old[:, 1, 2] if clockwise else old[:, 1, 2]
    intrinsics[:, 1, 2] = old[:, 0, 2] if clockwise else width - 1 - old[:, 0, 2]
    return replace(
        sample,
        images=torch.rot90(sample.images, -sign, (-2, -1)),
        depth=torch.rot90(sample.depth, -sign, (-2, -1)),
        intrinsics=intrinsics,
        cam_from_world=turn @ sample.cam_from_world,
    )


def disturbed_poses(sample: Sample, noise_px: float, rng: np.random.Generator) -> Tensor:
    """(N, 4, 4) cam_from_world with each source rotated at random by ``noise_px`` pixels (standard deviation).

    Structure from motion leaves a few tenths of a pixel; to first order an error of a source's position looks like
    a rotation in the small window round any one point.
    """
    poses = sample.cam_from_world.clone()
    for i in range(1, len(poses)):
        vector = rng.normal(0, noise_px / float(sample.intrinsics[i, 0, 0]), 3)
        poses[i, :3] = torch.from_numpy(cv2.Rodrigues(vector)[0]).to(poses.dtype) @ poses[i, :3]
    return poses


class SceneSamples(IterableDataset[Sample]):
    """An endless random stream of samples; folders are listed anew now and then, so that a growing set is used."""

    def __init__(
        self,
        roots: Sequence[Path],
        *,
        seed: int,
        rank: int = 0,
        settings: SamplingSettings | None = None,
        relist_every: int = 200,
    ) -> None:
        super().__init__()
        self.roots = list(roots)
        self.seed = seed
        self.rank = rank
        self.settings = settings or SamplingSettings()
        self.relist_every = relist_every

    def __iter__(self) -> Iterator[Sample]:
        """Yield samples for ever."""
        worker = torch.utils.data.get_worker_info()
        worker_id = worker.id if worker else 0
        # Processes that train together, and the workers of each, draw samples of their own.
        rng = np.random.default_rng([self.seed, worker_id, self.rank] if self.rank else [self.seed, worker_id])
        while True:
            scenes = find_true_scenes(self.roots, "train")
            if not scenes:
                msg = f"no scene with pair.txt and depths/ below {self.roots}; make some: python -m training.synthesize"
                raise SceneError(msg)
            found = False
            for _ in range(self.relist_every):
                sample = self._draw(scenes[rng.integers(len(scenes))], rng)
                if sample is not None:
                    found = True
                    yield sample
            if not found:
                msg = (
                    f"of {self.relist_every} views drawn from below {self.roots} none has a source in pair.txt and a "
                    f"true depth for {100 * LEAST_KNOWN:.0f} % of its pixels; give other scenes, of two views or more"
                )
                raise SceneError(msg)

    def _draw(self, true_scene: TrueScene, rng: np.random.Generator) -> Sample | None:
        settings = self.settings
        scene = true_scene.read()
        index = int(rng.integers(len(scene.views)))
        candidates: NDArray[np.int64] = np.array(scene.views[index].sources)
        if len(candidates) == 0:
            return None
        count = min(int(rng.integers(settings.min_sources, settings.max_sources + 1)), len(candidates))
        sources = rng.choice(candidates, size=count, replace=False)
        sample = load_sample(scene, index, [int(s) for s in sources], true_scene.true_depth(scene.views[index]))
        if (sample.depth > 0).float().mean() < LEAST_KNOWN:
            return None
        if rng.random() < settings.mirror:
            sample = mirrored(sample)
        if rng.random() < settings.turn:
            sample = turned(sample, clockwise=bool(rng.random() < 0.5))
        poses = sample.cam_from_world
        if settings.pose_noise_px and rng.random() < 0.5:
            poses = disturbed_poses(sample, settings.pose_noise_px * rng.random(), rng)
        near, far = sample.depth_range
        jitter = settings.range_jitter
        # Log-uniform. Photographs of 1280 pixels in a plot have 0.5 to 2 quarter-resolution pixels a plane; small
        # training pictures with the subject's own range have 0.1 and would not teach the network to look so far.
        near /= settings.near_pull ** (rng.random() if rng.random() < 0.5 else 0.0)
        images = sample.images
        if settings.colour_jitter:
            images = jitter_colour(images, settings.colour_jitter, rng)
        return replace(
            sample,
            images=images,
            cam_from_world=poses,
            depth_range=(near / (1 + jitter * rng.random()), far * (1 + 2 * jitter * rng.random())),
        )
