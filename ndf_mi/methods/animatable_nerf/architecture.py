"""Architectures of Animatable NeRF: `paper` as published, `fast` for minutes of training."""

from __future__ import annotations

from dataclasses import dataclass

from ndf_mi.field.presets import Preset
from ndf_mi.methods.volume.optimisation import Schedule


@dataclass(frozen=True)
class Architecture:
    """Sizes of the networks. γ is the frequency encoding.

    Attributes:
        name: of the preset.
        reach, reach_inside: metres outside and inside the posed body within which points are evaluated; the
            latter is at most the former.
        grid_rate: factor on the learning rate for the hash table.
        novel: rates and length of the stage that learns blend weights at frames without images.
        novel_share: of a budget's seconds, for that stage.
        novel_points: points drawn in each of its steps around the posed body, and around the body at rest.
        blend_layers: hidden widths of the network that corrects blend weights.
        blend_skip: after this many of these layers, its input is joined again; 0 for never.
        blend_octaves: octaves of γ on the point that enters it.
        blend_latent: width of a frame's latent code that enters it.
        canonical: encoding of the canonical point (`encoding`, `octaves` and `grid_…`), layers and
            activation of density and colour (`density_…`, `feature_width`, `colour_…`,
            `direction_octaves`). Its coordinates are `world`; entries on poses, normals, the band and its
            deformation have no meaning here.
        colour_latent: width of a frame's latent code that enters the colours: at the second of the preset's
            `colour_linear` layers, or at the first of `colour_layers`.
        agree_above: density in 1/m above which a point's blend weights of both spaces must agree.
        agree_every: one sample in so many is asked to.
    """

    name: str
    blend_layers: tuple[int, ...]
    blend_skip: int
    blend_octaves: int
    blend_latent: int
    canonical: Preset
    colour_latent: int
    agree_above: float
    novel: Schedule
    agree_every: int = 1
    reach: float = 0.05
    reach_inside: float = 0.05
    grid_rate: float = 1.0
    novel_share: float = 0.1
    novel_points: int = 65536


PAPER = Architecture(
    name="paper", blend_layers=(256,) * 8, blend_skip=5, blend_octaves=10, blend_latent=128,
    canonical=Preset(
        name="paper", coordinates="world", pose_layers=(), deformation_layers=(), encoding="frequency",
        octaves=10, density_layers=(256,) * 8, density_skip=5, feature_width=0, colour_linear=(256, 256),
        colour_layers=(128,), direction_octaves=4, density_activation="relu", density_gain=1.0,
        density_bias=0.0, density_limit=10000.0),
    colour_latent=128, agree_above=0.0,
    novel=Schedule(steps=200_000, learning_rate=5e-4, decay_steps=500_000))

FAST = Architecture(
    name="fast", blend_layers=(32, 32), blend_skip=0, blend_octaves=4, blend_latent=16,
    canonical=Preset(
        name="fast", coordinates="world", pose_layers=(), deformation_layers=(), grid_levels=8,
        grid_features=2, grid_entries=2**17, grid_base=16, grid_finest=256, density_layers=(64,),
        feature_width=16, colour_layers=(64,), direction_octaves=-1),
    colour_latent=16, agree_above=5.0, agree_every=4, grid_rate=5.0, reach_inside=0.03,
    novel=Schedule(steps=400, learning_rate=4e-3), novel_points=16384)
