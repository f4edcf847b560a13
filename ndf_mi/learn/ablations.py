"""The published ablations and two more, each as changes to a preset and to the training options."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Any

from ndf_mi.errors import InputError
from ndf_mi.field import Preset
from ndf_mi.learn.options import TrainingOptions


@dataclass(frozen=True)
class Ablation:
    """One row of the table.

    Attributes:
        title: what the row is called.
        meaning: what is taken away or exchanged, in a sentence.
        preset: changes to the architecture.
        training: changes to the training.
        at_least: entries of the preset that are raised to these values where they are less.
    """

    title: str
    meaning: str
    preset: dict[str, Any] = field(default_factory=dict)
    training: dict[str, Any] = field(default_factory=dict)
    at_least: dict[str, float] = field(default_factory=dict)

    def apply(self, preset: Preset, options: TrainingOptions) -> tuple[Preset, TrainingOptions]:
        """Preset and options of the ablated training."""
        raised = {key: max(value, getattr(preset, key)) for key, value in self.at_least.items()}
        preset = dataclasses.replace(preset, **raised)
        return dataclasses.replace(preset, **self.preset), dataclasses.replace(options, **self.training)


#: A sheet of a centimetre around the skin, in which nothing changes along l: as thin as samples can be trusted to meet.
#: Its density may be higher, so that so thin a sheet can be opaque, and the term against density at the band's edge is out of place.
_NAKED = {"distance": "none", "band": 0.005, "band_inside": 0.005, "band_fade": 0.0, "sample_factor": 4}

ABLATIONS: dict[str, Ablation] = {
    "full": Ablation("full model", "nothing is taken away"),
    "naked": Ablation(
        "naked model",
        "l = 0: density and colour live on the body's surface alone, a sheet of a centimetre, met by four times as many samples",
        _NAKED, {"edge_weight": 0.0}, {"density_limit": 2000.0},
    ),
    "no-pose": Ablation("without pose", "the pose vector reaches no network: one field for all frames, but for light on the turning normal",
                        {"pose_layers": ()}),
    "no-projection": Ablation(
        "without projection", "(x, y, z) in place of (u, v, l); nothing of the closest point reaches a network, and the pose, by which "
        "alone they know where the body is, has no noise",
        {"coordinates": "world", "normal_octaves": -1, "direction": "view"}, {"pose_noise": 0.0},
    ),
    "no-deform": Ablation("without deformation", "no deformation net between projection and field", {"deformation_layers": ()}),
    "one-piece": Ablation("one-piece atlas", "the body is cut open into one chart of texture coordinates", training={"atlas": "one-piece"}),
    "unsigned": Ablation("unsigned distance", "|l| in place of l", {"distance": "unsigned"}),
    "surface-point": Ablation(
        "surface point", "the closest point on the body at rest and l in place of (u, v, l)", {"coordinates": "surface"}
    ),
}


def ablation(name: str) -> Ablation:
    """The ablation of that name. Raises InputError naming those there are."""
    if name not in ABLATIONS:
        raise InputError("ablation", repr(name), "one of " + ", ".join(ABLATIONS))
    return ABLATIONS[name]
