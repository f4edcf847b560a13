"""`compare.json`: what was measured, image by image; the report is made of it, a later call goes on from it."""

from __future__ import annotations

import json
import os
import statistics
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from ndf_mi import files
from ndf_mi.errors import InputError
from ndf_mi.experiments import metrics

FORMAT = "ndf-comparison"
VERSION = 1


@dataclass(frozen=True)
class View:
    """One image of a split."""

    split: str
    camera: str
    frame: int

    @property
    def file(self) -> str:
        """The name of this view's picture."""
        return f"{self.split}/{self.camera}/{self.frame:06d}.png"


@dataclass(frozen=True)
class FrameSequence:
    """Successive frames, two at least, of a split in one of its cameras."""

    split: str
    camera: str
    frames: tuple[int, ...]

    @property
    def views(self) -> list[View]:
        """The images, in their order."""
        return [View(self.split, self.camera, frame) for frame in self.frames]

    @property
    def spacing(self) -> float:
        """How far apart the frames' numbers are, on average: 1 where none is left out."""
        return (self.frames[-1] - self.frames[0]) / (len(self.frames) - 1)


@dataclass
class Measured:
    """One image of one method.

    Attributes:
        view: which.
        seconds: that rendering took.
        figures: by the keys of `metrics.IMAGE_METRICS`.
        sampled: whether it counts in the split's means; an image that was rendered for a sequence alone does not.
    """

    view: View
    seconds: float
    figures: dict[str, float | None]
    sampled: bool = True


@dataclass
class Flicker:
    """The temporal consistency of one method in one sequence of n frames.

    Attributes:
        sequence: the frames.
        tpsnr: (n − 1) temporal PSNR in dB of each pair of frames; None where the body is out of sight.
        frozen: (n − 1) the same of a picture that does not change, which is how much the truth does.
    """

    sequence: FrameSequence
    tpsnr: list[float | None]
    frozen: list[float | None]


@dataclass
class MethodResult:
    """All that is known of one method.

    Attributes:
        key: name of the folder of its pictures.
        label: its name for people.
        fingerprint: of what was rendered; a changed one makes the images void.
        facts: of its training, JSON values.
        images: measured so far.
        flicker: of each sequence whose images are all there.
    """

    key: str
    label: str
    fingerprint: str
    facts: dict[str, Any] = field(default_factory=dict)
    images: list[Measured] = field(default_factory=list)
    flicker: list[Flicker] = field(default_factory=list)

    def mean(self, split: str, metric: str) -> float | None:
        """The mean over the sampled images of a split, of temporal PSNR that over the pairs of frames of its sequences.

        None where no image, or pair, defines the metric.
        """
        if metric == metrics.TEMPORAL:
            return metrics.average([v for known in self.flicker if known.sequence.split == split for v in known.tpsnr])
        return metrics.average([i.figures[metric] for i in self.images if i.sampled and i.view.split == split])

    def seconds_an_image(self) -> float | None:
        """The median over all images, which leaves out what the first ones spend on compiling."""
        return statistics.median(image.seconds for image in self.images) if self.images else None

    def find(self, view: View) -> Measured | None:
        """What was measured for a view, or None."""
        return next((image for image in self.images if image.view == view), None)


@dataclass
class Results:
    """A whole comparison. `about` holds what the report says of it: run, capture, command, machine, settings, protocol."""

    about: dict[str, Any] = field(default_factory=dict)
    methods: list[MethodResult] = field(default_factory=list)

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
        "fingerprint": method.fingerprint,
        "facts": method.facts,
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
