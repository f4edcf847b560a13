"""Neural Body as a method."""

from __future__ import annotations

from ndf_mi.capture.capture import Capture
from ndf_mi.methods.neural_body.architecture import Architecture
from ndf_mi.methods.neural_body.volume import NeuralBodyVolume
from ndf_mi.methods.volume.method import VolumeMethod, VolumePreset
from ndf_mi.methods.volume.optimisation import Schedule
from ndf_mi.methods.volume.rays import RaySettings

PAPER = VolumePreset(
    Architecture(), Schedule(steps=200_000, learning_rate=5e-4, decay_steps=500_000),
    RaySettings(rays=1024, samples=64, edge_kernel=5))

FAST = VolumePreset(
    Architecture(
        voxel=0.015, padding=0.1, code_rate=60.0, channels=(16, 32, 32, 32, 32), depths=(1, 2, 2, 2, 2),
        density_layers=(64, 64), latent=16, colour_width=64, position_octaves=4, direction_octaves=-1,
        reach=1, cover=0.99, activation="softplus", gain=100.0, bias=-4.0, limit=500.0),
    Schedule(steps=4000, learning_rate=4e-3),
    RaySettings(rays=1024, samples=64, min_transmittance=1e-3, opacity_weight=0.05), surface="offset")


class NeuralBody(VolumeMethod):
    """Neural Body (Peng et al. 2021, *Neural Body: Implicit Neural Representations with Structured Latent
    Codes*).

    Args:
        preset: `paper`, as published, or `fast`, which learns in minutes.
        samples: candidate samples a ray of images.
    """

    key, label = "neural-body", "Neural Body"
    presets = {"fast": FAST, "paper": PAPER}

    def volume(self, capture: Capture, architecture: Architecture) -> NeuralBodyVolume:
        """The volume on the capture's body."""
        return NeuralBodyVolume(capture, architecture)
