"""What a training step takes besides the parameters: rays with their targets, and all random numbers."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass

import mitsuba as mi
import numpy as np
from scipy import ndimage

from ndf_mi.body.poses import Poses
from ndf_mi.capture.camera import box_pixels, pixel_rays
from ndf_mi.capture.capture import Capture
from ndf_mi.capture.images import is_soft
from ndf_mi.errors import InputError
from ndf_mi.learn.mask_trust import MaskTrust
from ndf_mi.learn.options import TrainingOptions


@dataclass(frozen=True)
class PathSeeds:
    """Random numbers of a step through scattering.

    Attributes:
        shift: (3,) in [0, 1): the grid's offset in cells.
        seed: of the paths.
    """

    shift: np.ndarray
    seed: int


@dataclass(frozen=True)
class Batch:
    """The input of one step: R rays of one frame. All arrays but `camera` are float32.

    Attributes:
        frame: the frame's number.
        origin, direction: (3, R) world space; directions have unit length.
        target: (3, R) sRGB in [0, 1].
        mask: (R,) in [0, 1], the share of the pixel that the performer covers; of a capture with masks
            instead of mattes, 1 on the performer, else 0.
        mask_valid: (R,) in [0, 1], how far the mask gives the opacity: 0 near the edge of a mask without
            intermediate values, where pixels are partly covered; less than 1 where the mask is doubtful.
        in_box: (R,) 1 for pixels drawn from the whole box, 0 for those drawn from the mask, which are drawn
            more often than they occur in an image.
        jitter: in [0, 1), one number for each candidate sample of each ray, ray by ray.
        pose: (3·J,) axis-angles that the networks see, with noise.
        edge_active: whether the loss's term at the band's edge counts.
        camera: (R,) uint32, the index of each ray's camera in the `train` split; the number of these for
            another camera, which has no corrections.
        paths: only for steps through scattering.
    """

    frame: int
    origin: np.ndarray
    direction: np.ndarray
    target: np.ndarray
    mask: np.ndarray
    mask_valid: np.ndarray
    in_box: np.ndarray
    jitter: np.ndarray
    pose: np.ndarray
    edge_active: bool
    camera: np.ndarray
    paths: PathSeeds | None = None

    @property
    def ray(self) -> mi.Ray3f:
        """The rays as Mitsuba's."""
        return mi.Ray3f(mi.Point3f(self.origin), mi.Vector3f(self.direction))


@dataclass(frozen=True)
class _View:
    """One training image: 8-bit colours, matte and weights, and the indices of the pixels that may be
    drawn."""

    image: np.ndarray
    mask: np.ndarray
    mask_valid: np.ndarray
    mask_pixels: np.ndarray
    box_pixels: np.ndarray


class BatchSampler:
    """Draws batches from the training split, each from all cameras of one frame. All images are held in
    memory.

    Args:
        capture: the capture.
        options: sampling.
        sample_factor: of the preset.
        poses: of the reference surface. Pixels are drawn from the box around it and the capture's body.
        held_back: views that are not drawn before `release`: indices of their frames and cameras in the
            split.
        band: metres around the reference surface where the field may be non-zero.

    Raises:
        InputError: the split is empty, or an image shows nothing of the performer.
    """

    def __init__(self, capture: Capture, options: TrainingOptions, sample_factor: int,
                 poses: Poses, held_back: Collection[tuple[int, int]] = (), band: float = 0.1) -> None:
        split = capture.splits["train"]
        self._options = options
        self._poses = poses
        self._candidates = options.rays * options.samples * sample_factor
        self._frames = split.frames
        self._cameras = [capture.cameras[name] for name in split.cameras]
        if not self._frames or not self._cameras:
            raise InputError(f"{capture.path / 'capture.json'}: splits.train", "no cameras or no frames",
                             "at least one of each")
        # Only the opacity term uses masks.
        trust = MaskTrust(capture, band) if options.mask_trust and options.opacity_weight > 0 else None
        self._views: dict[tuple[int, int], _View] = {}
        for row, frame in enumerate(self._frames):
            low, high = drawing_box(capture, poses, frame, options.box_padding)
            columns = range(len(self._cameras))
            images = [capture.image(split.cameras[column], frame) for column in columns]
            mattes = [capture.matte(split.cameras[column], frame) for column in columns]
            weights = [np.ones_like(matte) for matte in mattes]
            if trust is not None:
                weights = trust(frame, poses.vertices[poses.index(frame)],
                                [self._cameras[column] for column in columns], images, mattes)
            for column, image, matte, weight in zip(columns, images, mattes, weights, strict=True):
                name = split.cameras[column]
                mask = matte >= 0.5
                allowed = ~_edge(mask, options.edge_kernel)
                box = box_pixels(self._cameras[column], low, high) & allowed
                if not (mask & allowed).any() or not box.any():
                    raise InputError(f"camera {name}, frame {frame}", "no pixel of the performer in view",
                                     "a mask that is not empty")
                # A matte says how far pixels on the edge are covered, a mask does not.
                valid = np.ones(mask.shape) if is_soft(matte) else ~_edge(mask, options.opacity_edge)
                self._views[row, column] = _View(
                    _bytes(image).reshape(-1, 3), _bytes(matte).ravel(), _bytes(valid * weight).ravel(),
                    np.flatnonzero(mask & allowed).astype(np.uint32), np.flatnonzero(box).astype(np.uint32))
        self._draw_from(view for view in self._views if view not in held_back)

    def release(self) -> None:
        """Draws from the views that were held back as well."""
        self._draw_from(self._views)

    def _draw_from(self, views: Iterable[tuple[int, int]]) -> None:
        self._columns: dict[int, list[int]] = {}
        for row, column in views:
            self._columns.setdefault(row, []).append(column)

    def __call__(self, rng: np.random.Generator, edge_active: bool = False,
                 scattering: bool = False) -> Batch:
        """A random batch: `rays` rays of a random frame, spread evenly over the cameras.

        Args:
            rng: source of all random numbers, drawn in an order that does not change.
            edge_active: whether the loss's term at the band's edge counts.
            scattering: whether the step is through scattering and needs seeds for its paths.
        """
        options = self._options
        row = list(self._columns)[int(rng.integers(len(self._columns)))]
        columns = self._columns[row]
        counts = np.full(len(columns), options.rays // len(columns))
        counts[: options.rays % len(columns)] += 1
        rng.shuffle(counts)
        parts = [self._draw(rng, row, column, int(count))
                 for column, count in zip(columns, counts, strict=True) if count]
        rays = [np.concatenate(values, axis=-1, dtype=np.float32) for values in zip(*parts, strict=True)]
        camera = np.repeat(np.array(columns, dtype=np.uint32), counts)
        jitter = rng.random(self._candidates, dtype=np.float32)
        pose = self._poses.pose[self._poses.index(self._frames[row])].astype(np.float32)
        if options.pose_noise > 0:
            # All joints but the root, whose rotation the networks never see.
            pose[1:] += rng.normal(0.0, options.pose_noise, pose[1:].shape).astype(np.float32)
        paths = PathSeeds(rng.random(3), int(rng.integers(2**32))) if scattering else None
        origin, direction, target, mask, mask_valid, in_box = rays
        return Batch(self._frames[row], origin, direction, target, mask, mask_valid, in_box, jitter,
                     pose.ravel(), edge_active, camera, paths)

    def _draw(self, rng: np.random.Generator, row: int, column: int, count: int) -> tuple[np.ndarray, ...]:
        view = self._views[row, column]
        on_mask = round(count * self._options.mask_share)
        pixels = np.concatenate([rng.choice(view.mask_pixels, on_mask),
                                 rng.choice(view.box_pixels, count - on_mask)])
        origin, direction = pixel_rays(self._cameras[column], pixels)
        target = view.image[pixels].T.astype(np.float32) / 255
        in_box = np.arange(count) >= on_mask
        mask, mask_valid = (of[pixels].astype(np.float32) / 255 for of in (view.mask, view.mask_valid))
        return origin, direction, target, mask, mask_valid, in_box


def drawing_box(capture: Capture, poses: Poses, frame: int, padding: float) -> tuple[np.ndarray, np.ndarray]:
    """Corners (3,) and (3,) of the box, in world space, from whose pixels rays are drawn.

    Args:
        poses: of the reference surface; the box is around it and the capture's body.
        padding: in metres.
    """
    vertices = np.concatenate([each.vertices[each.index(frame)] for each in (capture.poses, poses)])
    return vertices.min(0) - padding, vertices.max(0) + padding


def _bytes(values: np.ndarray) -> np.ndarray:
    """Values in [0, 1] in steps of 1/255, as uint8."""
    return np.round(values * 255).astype(np.uint8)


def _edge(mask: np.ndarray, kernel: int) -> np.ndarray:
    """Pixels around which a square of `kernel` pixels holds both performer and background."""
    if kernel < 2:
        return np.zeros_like(mask)
    square = np.ones((kernel, kernel), bool)
    return ndimage.binary_dilation(mask, square) & ~ndimage.binary_erosion(mask, square, border_value=1)
