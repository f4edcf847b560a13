"""Animatable NeRF as a method."""

from __future__ import annotations

from ndf_mi.capture.capture import Capture
from ndf_mi.methods.animatable_nerf.architecture import FAST, PAPER, Architecture
from ndf_mi.methods.animatable_nerf.novel_poses import NovelPoses
from ndf_mi.methods.animatable_nerf.volume import AnimatableNerfVolume
from ndf_mi.methods.volume.method import VolumeMethod, VolumePreset
from ndf_mi.methods.volume.optimisation import Schedule
from ndf_mi.methods.volume.rays import RaySettings


class AnimatableNerf(VolumeMethod):
    """Animatable NeRF (Peng et al. 2021): a NeRF around the body at rest, into which points near the posed
    body are carried by inverse skinning with learnt blend weights.

    The last part of the training learns blend weights at all frames of the capture's poses that are not in
    the training split, from the poses alone. Arguments are those of :class:`VolumeMethod`.
    """

    key, label = "animatable-nerf", "Animatable NeRF"
    presets = {
        "fast": VolumePreset(
            FAST, Schedule(steps=4000, learning_rate=8e-3),
            RaySettings(rays=512, min_transmittance=1e-3, opacity_weight=0.05), surface="offset"),
        "paper": VolumePreset(
            PAPER, Schedule(steps=200_000, learning_rate=5e-4, decay_steps=500_000),
            RaySettings(edge_kernel=5)),
    }

    def volume(self, capture: Capture, architecture: Architecture) -> AnimatableNerfVolume:
        """Raises InputError where the body has no skinning model."""
        return AnimatableNerfVolume(capture, architecture)

    def final_stage(self, volume: AnimatableNerfVolume) -> NovelPoses | None:
        """Blend weights at the frames without images."""
        return NovelPoses(volume) if volume.untrained else None
