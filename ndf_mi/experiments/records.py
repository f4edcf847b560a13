"""What experiments measure: the values that studies store on disk and that reports show."""

from __future__ import annotations

import math
import statistics
from dataclasses import dataclass
from typing import Any

from msgspec import Struct

from ndf_mi.experiments import metrics

SPLITS = {
    "novel_view": "novel views",
    "novel_pose": "novel poses",
    "sequence": "successive frames",
    "train": "training views",
}
"""The splits that are measured, in this order, and their names for readers."""
HELD_OUT = ("novel_view", "novel_pose")


class View(Struct, frozen=True):
    """One image of a split."""

    split: str
    camera: str
    frame: int

    @property
    def file(self) -> str:
        """The file name of this view's picture, relative to the folder of its method."""
        return f"{self.split}/{self.camera}/{self.frame:06d}.png"


class FrameSequence(Struct, frozen=True):
    """Two or more successive frames of a split, seen by one of its cameras."""

    split: str
    camera: str
    frames: tuple[int, ...]

    @property
    def views(self) -> list[View]:
        """The images in order."""
        return [View(self.split, self.camera, frame) for frame in self.frames]

    @property
    def spacing(self) -> float:
        """The mean difference between successive frame numbers; 1 where no frame is missing."""
        return (self.frames[-1] - self.frames[0]) / (len(self.frames) - 1)


class Trained(Struct, tag="trained", tag_field="kind"):
    """A training that has ended.

    Attributes:
        metadata: what the method reports of itself and of the training.
        peak_memory: bytes of main memory that the process held at most since the training was begun or
            continued; None where that was not measured.
    """

    metadata: dict[str, Any] = {}
    peak_memory: int | None = None


class Measured(Struct, tag="image", tag_field="kind"):
    """One image of one method.

    Attributes:
        view: which image.
        seconds: the time that rendering took.
        figures: metrics by the keys of `metrics.IMAGE_METRICS`; None where a metric is undefined. Older
            files lack `metrics.MATCHED`.
        sampled: whether the image counts in the split's means. Images that only a sequence needs do not.
        noise: PSNR in dB that the sampling noise of the method's pictures would have by itself; None where
            there is none.
    """

    view: View
    seconds: float
    figures: dict[str, float | None]
    sampled: bool = True
    noise: float | None = None


class Flicker(Struct, tag="flicker", tag_field="kind"):
    """The temporal consistency of one method in one sequence of n frames.

    Attributes:
        sequence: the frames.
        tpsnr: (n − 1) temporal PSNR in dB of each pair of frames; None where the body is out of sight.
        frozen: (n − 1) the same for a picture that does not change, which measures how much the truth
            changes.
    """

    sequence: FrameSequence
    tpsnr: list[float | None]
    frozen: list[float | None]


class MethodResult(Struct):
    """Everything that was measured of one method.

    Attributes:
        key: the method's name in a study, and the name of the folder of its pictures.
        label: its name for readers.
        cache_key: identifies what was rendered; images with another key are stale.
        metadata: what the method reports of itself and its training; JSON values.
        images: the images measured so far.
        flicker: temporal consistency of each sequence whose images are complete.
        group: what trainings of one method with different seeds share; empty where there is only one.
    """

    key: str
    label: str
    cache_key: str
    metadata: dict[str, Any] = {}
    images: list[Measured] = []
    flicker: list[Flicker] = []
    group: str = ""

    def mean(self, split: str, metric: str) -> float | None:
        """The mean over the sampled images of a split; for temporal PSNR, over the pairs of frames of its
        sequences. None where the metric is undefined for all of them.
        """
        if metric == metrics.TEMPORAL:
            known = (flicker for flicker in self.flicker if flicker.sequence.split == split)
            return metrics.average([value for flicker in known for value in flicker.tpsnr])
        images = (image for image in self.images if image.sampled and image.view.split == split)
        return metrics.average([image.figures.get(metric) for image in images])

    @property
    def camera_colours(self) -> bool:
        """Whether a map of colour was trained for each camera, which held-out cameras do not have."""
        return bool((self.metadata.get("training") or {}).get("camera_colours"))

    def seconds_an_image(self) -> float | None:
        """The median over all images, so that kernel compilation in the first few does not count."""
        return statistics.median(image.seconds for image in self.images) if self.images else None

    def find(self, view: View) -> Measured | None:
        """The measurement of a view, or None."""
        return next((image for image in self.images if image.view == view), None)

    def summary(self, splits: list[str]) -> dict[str, Any]:
        """JSON values for readers of the study's file, with means by split and metric."""
        means = {split: {key: self.mean(split, key) for key in metrics.LABELS} for split in splits}
        return {
            "key": self.key, "label": self.label, "cache_key": self.cache_key, "metadata": self.metadata,
            "seconds_an_image": self.seconds_an_image(), "means": means,
        }


@dataclass(frozen=True)
class Trainings:
    """The trainings of one method, which differ by their seeds; at least one."""

    members: tuple[MethodResult, ...]

    @property
    def first(self) -> MethodResult:
        """The training with the first seed: what pictures show."""
        return self.members[0]

    @property
    def label(self) -> str:
        """The method's name for readers."""
        return self.first.label

    def mean(self, split: str, metric: str) -> float | None:
        """The mean of `MethodResult.mean` over the trainings."""
        return metrics.average([member.mean(split, metric) for member in self.members])

    def spread(self, split: str, metric: str) -> float | None:
        """The standard deviation of `MethodResult.mean` over the trainings; None of fewer than two finite
        values."""
        means = [member.mean(split, metric) for member in self.members]
        finite = [value for value in means if value is not None and math.isfinite(value)]
        return statistics.stdev(finite) if len(finite) > 1 else None


class Results(Struct):
    """A whole comparison; `about` holds what the report says of it, such as the capture and the command."""

    about: dict[str, Any] = {}
    methods: list[MethodResult] = []

    def method(self, key: str) -> MethodResult | None:
        """The result with this key, or None."""
        return next((method for method in self.methods if method.key == key), None)

    def trainings(self) -> list[Trainings]:
        """The methods, with the trainings of each."""
        found: dict[str, list[MethodResult]] = {}
        for method in self.methods:
            found.setdefault(method.group or method.key, []).append(method)
        return [Trainings(tuple(members)) for members in found.values()]

    def first(self) -> Results:
        """The same with the first training of each method."""
        return Results(self.about, [each.first for each in self.trainings()])

    def splits(self) -> list[str]:
        """The splits that have images, in the order in which they were measured."""
        return list(dict.fromkeys(image.view.split for method in self.methods for image in method.images))

    def summary(self) -> dict[str, Any]:
        """JSON values for readers of the study's file: a summary of each method."""
        return {"methods": [method.summary(self.splits()) for method in self.methods]}
