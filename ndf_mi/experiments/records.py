"""`compare.json`: what was measured, image by image; the report is made of it, a later call goes on from it."""

from __future__ import annotations

import json
import os
import statistics
from pathlib import Path
from typing import Any

from msgspec import Struct
from msgspec.structs import asdict

from ndf_mi import files
from ndf_mi.errors import InputError
from ndf_mi.experiments import metrics

FORMAT = "ndf-comparison"
VERSION = 1


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


class Measured(Struct):
    """One image of one method.

    Attributes:
        view: which image.
        seconds: the time that rendering took.
        figures: metrics by the keys of `metrics.IMAGE_METRICS`; None where a metric is undefined.
        sampled: whether the image counts in the split's means. Images that only a sequence needs do not.
    """

    view: View
    seconds: float
    figures: dict[str, float | None]
    sampled: bool = True


class Flicker(Struct):
    """The temporal consistency of one method in one sequence of n frames.

    Attributes:
        sequence: the frames.
        tpsnr: (n − 1) temporal PSNR in dB of each pair of frames; None where the body is out of sight.
        frozen: (n − 1) the same for a picture that does not change, which measures how much the truth changes.
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
    """

    key: str
    label: str
    cache_key: str
    metadata: dict[str, Any] = {}
    images: list[Measured] = []
    flicker: list[Flicker] = []

    def mean(self, split: str, metric: str) -> float | None:
        """The mean over the sampled images of a split; for temporal PSNR, over the pairs of frames of its sequences.

        None where the metric is undefined for all of them.
        """
        if metric == metrics.TEMPORAL:
            return metrics.average([v for known in self.flicker if known.sequence.split == split for v in known.tpsnr])
        return metrics.average([i.figures[metric] for i in self.images if i.sampled and i.view.split == split])

    def seconds_an_image(self) -> float | None:
        """The median over all images, so that kernel compilation in the first few does not count."""
        return statistics.median(image.seconds for image in self.images) if self.images else None

    def find(self, view: View) -> Measured | None:
        """The measurement of a view, or None."""
        return next((image for image in self.images if image.view == view), None)


class Results(Struct):
    """A whole comparison. `about` holds what the report says of it: run, capture, command, machine, settings, protocol."""

    about: dict[str, Any] = {}
    methods: list[MethodResult] = []

    def method(self, key: str) -> MethodResult | None:
        """The result with this key, or None."""
        return next((method for method in self.methods if method.key == key), None)

    def splits(self) -> list[str]:
        """The splits that have images, in the order in which they were measured."""
        return list(dict.fromkeys(image.view.split for method in self.methods for image in method.images))

    def write(self, path: str | os.PathLike[str]) -> None:
        """Writes `compare.json`, means included, whole or not at all."""
        files.write_json(
            path,
            {
                "format": FORMAT,
                "version": VERSION,
                **self.about,
                "methods": [_method_to_json(method, self.splits()) for method in self.methods],
            },
        )

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Results:
        """Reads `compare.json`.

        Raises:
            InputError: the file is missing, is not such a file, or is of another version.
        """
        expected = f"a {FORMAT} file of version {VERSION}"
        try:
            document = json.loads(Path(path).read_text(encoding="utf-8"))
            found = (document.pop("format"), document.pop("version"))
            methods = [_method_from_json(method) for method in document.pop("methods")] if found[1] == VERSION else []
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise InputError(path, f"a file that can't be read ({error!r})", expected, "Remove it.") from error
        if found != (FORMAT, VERSION):
            raise InputError(path, f"format {found[0]!r} of version {found[1]!r}", expected, "Remove it.")
        return cls(document, methods)


def _method_to_json(method: MethodResult, splits: list[str]) -> dict[str, Any]:
    means = {split: {key: metrics.to_json(method.mean(split, key)) for key in metrics.LABELS} for split in splits}
    return {
        "key": method.key,
        "label": method.label,
        "fingerprint": method.cache_key,
        "facts": method.metadata,
        "seconds_an_image": method.seconds_an_image(),
        "means": means,
        "flicker": [
            {
                **asdict(known.sequence),
                "tpsnr": [metrics.to_json(value) for value in known.tpsnr],
                "frozen": [metrics.to_json(value) for value in known.frozen],
            }
            for known in method.flicker
        ],
        "images": [
            {
                **asdict(image.view),
                "seconds": image.seconds,
                "sampled": image.sampled,
                **{key: metrics.to_json(value) for key, value in image.figures.items()},
            }
            for image in method.images
        ],
    }


def _method_from_json(document: dict[str, Any]) -> MethodResult:
    # `sampled` and `flicker` may be absent: files written before sequences were measured have neither.
    images = [
        Measured(
            View(entry["split"], entry["camera"], entry["frame"]),
            entry["seconds"],
            {key: metrics.from_json(entry[key]) for key in metrics.IMAGE_METRICS},
            entry.get("sampled", True),
        )
        for entry in document["images"]
    ]
    flicker = [
        Flicker(
            FrameSequence(entry["split"], entry["camera"], tuple(entry["frames"])),
            [metrics.from_json(value) for value in entry["tpsnr"]],
            [metrics.from_json(value) for value in entry["frozen"]],
        )
        for entry in document.get("flicker", [])
    ]
    return MethodResult(document["key"], document["label"], document["fingerprint"], document["facts"], images, flicker)
