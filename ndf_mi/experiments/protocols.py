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
from ndf_mi.capture.document import Split
from ndf_mi.deprecated import rename_entry
from ndf_mi.errors import InputError
from ndf_mi.experiments.protocol_differences import differences

HELD_OUT = ("novel_view", "novel_pose")


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

    def frames(self, split: Split) -> tuple[int, ...]:
        """The frames of a held-out split that are measured. A split without others is measured whole."""
        return split.every(self.every)

    def check(self, capture: Capture) -> None:
        """Checks that a capture holds what the protocol needs; `default` takes any.

        Raises:
            InputError: the number of cameras or frames is wrong, a test camera is also a training camera, a
                novel view shows a frame that was not trained on, or a novel pose one that was.
        """
        if self.train_cameras is None:
            return
        train = capture.splits["train"]
        if len(train.cameras) != self.train_cameras:
            raise self._lacks(
                capture, "train.cameras", f"{len(train.cameras)} cameras", f"{self.train_cameras} cameras"
            )
        if len(train.frames) < self.train_frames:
            raise self._lacks(
                capture, "train.frames", f"{len(train.frames)} frames", f"at least {self.train_frames}"
            )
        for name, least in self.measured_frames:
            split = capture.splits[name]
            if len(split.cameras) < self.test_cameras:
                expected = f"at least {self.test_cameras}, none of them a training camera"
                raise self._lacks(capture, f"{name}.cameras", f"{len(split.cameras)} cameras", expected)
            both = sorted(set(split.cameras) & set(train.cameras))
            if both:
                raise self._lacks(
                    capture, f"{name}.cameras", f"{both[0]}, a training camera", "cameras not trained on"
                )
            left = len(self.frames(split))
            if left < least:
                found = f"{len(split.frames)} frames; every {self.every}th makes {left}"
                raise self._lacks(capture, f"{name}.frames", found, f"enough for at least {least}")
            self._check_frames(capture, name, train)

    def _check_frames(self, capture: Capture, name: str, train: Split) -> None:
        trained = set(train.frames)
        novel = name == "novel_pose"
        wrong = [frame for frame in capture.splits[name].frames if (frame in trained) == novel]
        if wrong:
            found = f"frame {wrong[0]}, {'a' if novel else 'no'} training frame"
            raise self._lacks(capture, f"{name}.frames", found, f"frames {'not ' if novel else ''}trained on")

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
            notes.append(
                f"The protocol's images are over black; this capture's background is ({colour}) in sRGB."
            )
        if self.layout is not None:
            notes += differences(self.layout, self.every, capture)
        images = [
            len(capture.splits[name].cameras) * len(self.frames(capture.splits[name])) for name in HELD_OUT
        ]
        if self.max_images is None and max_images is not None and max_images < max(images):
            whole = " and ".join(map(str, images))
            notes.append(
                f"At most {max_images} images of each split are measured; the protocol measures all, {whole}."
            )
        return notes

    def metadata(
        self, training: Mapping[str, Any] | None, capture: Capture, max_images: int | None = None
    ) -> dict[str, Any]:
        """JSON values that describe the protocol in results and reports; arguments as of `notes`."""
        return {
            "name": self.name, "description": self.description, "headline": list(self.headline),
            "notes": self.notes(training, capture, max_images),
        }

    def _lacks(self, capture: Capture, key: str, found: str, expected: str) -> InputError:
        where = f"{capture.path / 'capture.json'}: splits.{key}"
        return InputError(
            where, found, f"{expected}, for protocol {self.name}",
            "`--protocol default` measures any capture.",
        )


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
