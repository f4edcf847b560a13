"""Evaluation protocols: which images of a capture are measured, what the capture must hold, and which metrics
lead.

`docs/protocols.md` describes what each protocol takes from its publication, and what importing and training
decide.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ndf_mi.capture.capture import Capture
from ndf_mi.deprecated import rename_entry
from ndf_mi.errors import InputError
from ndf_mi.experiments.protocol_differences import differences
from ndf_mi.experiments.records import HELD_OUT


@dataclass(frozen=True)
class Protocol:
    """How images are chosen, and what a capture must hold so that its figures may carry the protocol's name.

    Attributes:
        name: the option's value.
        description: one sentence for the report.
        every: measures every n-th frame of a held-out split, counted by frame number from its first frame.
        max_images: images of a held-out split, drawn at random where there are more; None measures all.
        headline: keys of `metrics.LABELS` that tables lead with, in order.
        train_cameras: number of cameras of the training split; None for any.
        test_cameras: least number of cameras of each held-out split.
        train_frames: least number of frames of the training split.
        measured_frames: least number of measured frames, by held-out split.
        edge_kernels: values that the training option `edge_kernel` may have; empty for any.
        black: whether images are composited over black.
        layout: the layout that captures are imported from by `ndf-mi capture import`; None for any.
    """

    name: str
    description: str
    every: int = 1
    max_images: int | None = None
    headline: tuple[str, ...] = ("box_psnr", "box_ssim", "box_ssim_range2", "box_tpsnr")
    train_cameras: int | None = None
    test_cameras: int = 1
    train_frames: int = 1
    measured_frames: tuple[tuple[str, int], ...] = ()
    edge_kernels: tuple[int, ...] = ()
    black: bool = False
    layout: str | None = None

    def check(self, capture: Capture) -> None:
        """Checks that a capture holds what the protocol needs; `default` takes any.

        Raises:
            InputError: the number of cameras or frames is wrong, a test camera is also a training camera, a
                novel view shows a frame that was not trained on, or a novel pose one that was.
        """

        def expect(holds: bool, key: str, found: str, expected: str) -> None:
            if not holds:
                where = f"{capture.path / 'capture.json'}: splits.{key}"
                expected = f"{expected}, for protocol {self.name}"
                raise InputError(where, found, expected, "`--protocol default` measures any capture.")

        if self.train_cameras is None:
            return
        train, trained = capture.splits["train"], set(capture.splits["train"].frames)
        cameras, frames = len(train.cameras), len(train.frames)
        expected = f"{self.train_cameras} cameras"
        expect(cameras == self.train_cameras, "train.cameras", f"{cameras} cameras", expected)
        expected = f"at least {self.train_frames}"
        expect(frames >= self.train_frames, "train.frames", f"{frames} frames", expected)
        for name, least in self.measured_frames:
            split = capture.splits[name]
            cameras, measured = len(split.cameras), len(split.every(self.every))
            expected = f"at least {self.test_cameras}, none of them a training camera"
            expect(cameras >= self.test_cameras, f"{name}.cameras", f"{cameras} cameras", expected)
            for camera in sorted(set(split.cameras) & set(train.cameras)):
                expect(False, f"{name}.cameras", f"{camera}, a training camera", "cameras not trained on")
            found = f"{len(split.frames)} frames; every {self.every}th makes {measured}"
            expect(measured >= least, f"{name}.frames", found, f"enough for at least {least}")
            novel = name == "novel_pose"
            expected = f"frames {'not ' if novel else ''}trained on"
            for frame in split.frames:
                found = f"frame {frame}, {'a' if novel else 'no'} training frame"
                expect((frame in trained) != novel, f"{name}.frames", found, expected)

    def notes(
        self, training: Mapping[str, Any] | None, capture: Capture, max_images: int | None = None
    ) -> list[str]:
        """Sentences on how training, capture and images differ from the protocol's; empty if they do not.

        Args:
            training: the run's training options by name; None if unknown.
            capture: its background, cameras and frames are compared.
            max_images: the number given to `choose_views`.
        """
        notes = []
        kernel = (training or {}).get("edge_kernel")
        if self.edge_kernels and kernel not in self.edge_kernels:
            wanted = " or ".join(map(str, self.edge_kernels))
            notes.append(
                f"The protocol trains without the edge band of the masks (kernel {wanted}); the run's kernel "
                f"is {'unknown' if kernel is None else kernel}. "
                f"`ndf-mi optimise --option edge_kernel={self.edge_kernels[0]}` follows it."
            )
        if self.black and capture.background.any():
            colour = ", ".join(f"{value:.2f}" for value in capture.background)
            background = f"this capture's background is ({colour}) in sRGB"
            notes.append(f"The protocol's images are over black; {background}.")
        if self.layout is not None:
            notes += differences(self.layout, self.every, capture)
        splits = (capture.splits[name] for name in HELD_OUT)
        images = [len(split.cameras) * len(split.every(self.every)) for split in splits]
        if self.max_images is None and max_images is not None and max_images < max(images):
            count = f"At most {max_images} images of each split are measured"
            notes.append(f"{count}; the protocol measures all, {' and '.join(map(str, images))}.")
        return notes

    def metadata(
        self, training: Mapping[str, Any] | None, capture: Capture, max_images: int | None = None
    ) -> dict[str, Any]:
        """JSON values that describe the protocol in results and reports; arguments as of `notes`."""
        return {
            "name": self.name, "description": self.description, "headline": list(self.headline),
            "notes": self.notes(training, capture, max_images),
        }


DEFAULT = Protocol(
    "default", "Images of the held-out splits, chosen at random where there are more than asked for.",
    max_images=48, headline=("box_psnr", "box_ssim", "box_flip", "box_tpsnr"),
)
ZJU = Protocol(
    "zju",
    "ZJU-MoCap as in Neural Body and NDF: four training cameras, all others tested, every 30th frame of each "
    "split.",
    every=30, train_cameras=4, test_cameras=17, train_frames=60,
    measured_frames=(("novel_view", 2), ("novel_pose", 7)), edge_kernels=(3, 5), black=True, layout="zju",
)
DYNACAP = Protocol(
    "dynacap",
    "DynaCap as in NDF: trained on 1,000 frames of ten cameras; tested on five others, in every 30th of "
    "these and of the next 1,000 frames.",
    every=30, train_cameras=10, test_cameras=5, train_frames=1000,
    measured_frames=(("novel_view", 34), ("novel_pose", 34)), edge_kernels=(3,), black=True, layout="dynacap",
)
PROTOCOLS = {protocol.name: protocol for protocol in (DEFAULT, ZJU, DYNACAP)}
_OLD_NAMES = {"ours": "default"}


def named(name: str) -> Protocol:
    """The protocol of this name. Raises InputError if there is none."""
    name = rename_entry(name, _OLD_NAMES)
    if name not in PROTOCOLS:
        raise InputError("option protocol", repr(name), "one of " + ", ".join(PROTOCOLS))
    return PROTOCOLS[name]
