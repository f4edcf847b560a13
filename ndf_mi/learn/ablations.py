"""The paper's ablations and two more, each as changes to the preset and the training options."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Any

from ndf_mi.errors import InputError
from ndf_mi.field import Preset
from ndf_mi.learn.options import TrainingOptions


@dataclass(frozen=True)
class Ablation:
    """One row of the ablation table.

    Attributes:
        title: the row's title.
        meaning: what is removed or replaced, in a sentence.
        preset: changes to the preset.
        training: changes to the training options.
        at_least: lower bounds on the preset's entries.
    """

    title: str
    meaning: str
    preset: dict[str, Any] = field(default_factory=dict)
    training: dict[str, Any] = field(default_factory=dict)
    at_least: dict[str, float] = field(default_factory=dict)

    def apply(self, preset: Preset, options: TrainingOptions) -> tuple[Preset, TrainingOptions]:
        """Preset and training options with this ablation."""
        raised = {key: max(value, getattr(preset, key)) for key, value in self.at_least.items()}
        preset = dataclasses.replace(preset, **raised)
        return dataclasses.replace(preset, **self.preset), dataclasses.replace(options, **self.training)


#: A layer of one centimetre around the skin in which nothing depends on l. A thinner one would be missed by
#: samples. Its density limit is higher, so that a thin layer can be opaque; it consists of edge only, so the
#: edge term is off.
_SKIN_LAYER = {"distance": "none", "band": 0.005, "band_inside": 0.005, "band_fade": 0.0, "sample_factor": 4}

ABLATIONS: dict[str, Ablation] = {
    "full": Ablation("full model", "nothing is removed"),
    "naked": Ablation(
        "naked model",
        "l = 0: density and colour exist only on the body's surface, in a layer of one centimetre with four "
        "times as many samples",
        _SKIN_LAYER, {"edge_weight": 0.0, "surface": "body"}, {"density_limit": 2000.0}),
    "no-pose": Ablation(
        "without pose",
        "no network sees the pose: one field for all frames, except for the light on the turning normal",
        {"pose_layers": ()}),
    "no-projection": Ablation(
        "without projection",
        "(x, y, z) replaces (u, v, l), and no network sees the closest point; the pose, the only input that "
        "says where the body is, has no noise",
        {"coordinates": "world", "normal_octaves": -1, "direction": "view"}, {"pose_noise": 0.0}),
    "no-deform": Ablation("without deformation", "no deformation network between projection and field",
                          {"deformation_layers": ()}),
    "one-piece": Ablation("one-piece atlas",
                          "the body is cut open into a single chart of texture coordinates",
                          training={"atlas": "one-piece"}),
    "unsigned": Ablation("unsigned distance", "|l| replaces l", {"distance": "unsigned"}),
    "surface-point": Ablation("surface point",
                              "the closest point on the body at rest and l replace (u, v, l)",
                              {"coordinates": "surface"}),
}


def ablation(name: str) -> Ablation:
    """The ablation of that name. Raises InputError, which lists the names, if there is none."""
    if name not in ABLATIONS:
        raise InputError("ablation", repr(name), "one of " + ", ".join(ABLATIONS))
    return ABLATIONS[name]
