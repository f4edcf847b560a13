"""A preset and training options from a command line, with single entries changed by NAME=VALUE."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from typing import Any

from ndf_mi.deprecated import PRESET_FIELDS, PRESET_VALUES, TRAINING_FIELDS, rename_entry
from ndf_mi.errors import InputError
from ndf_mi.field import PRESETS, Preset, preset
from ndf_mi.learn.ablations import ABLATIONS, ablation
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.learn.scattering import SCATTERING_STEPS, check_integrator, relightable
from ndf_mi.options import option_value
from ndf_mi.run import QUADRATURE

#: Steps of a training that ends by the clock: more than it can take.
UNLIMITED = 10**9
_ARCHITECTURE = tuple(field.name for field in dataclasses.fields(Preset) if field.name != "name")
_TRAINING = tuple(field.name for field in dataclasses.fields(TrainingOptions))

NAMES = tuple(sorted({*_ARCHITECTURE, *_TRAINING}))
"""The allowed values of NAME."""

OPTION_HELP = (
    "Any other entry of the preset or of the training options as NAME=VALUE, for example band=0.12, "
    "rays=2048 or density_layers=[128,128]. Can be given several times. NAME is one of "
    f"{', '.join(NAMES)}."
)
PRESET_HELP = f"one of {', '.join(PRESETS)}"
ABLATION_NAMES = tuple(ABLATIONS)


def configured(
    preset_name: str,
    entries: Sequence[str] = (),
    *,
    ablation_name: str = "full",
    steps: int | None = None,
    seconds: float | None = None,
    seed: int | None = None,
    integrator: str = QUADRATURE,
    planned: Preset | None = None,
    refine: tuple[str, ...] | None = None,
    camera_colours: bool | None = None,
) -> tuple[Preset, TrainingOptions]:
    """A preset and its training options, first ablated, then changed by the other arguments.

    Args:
        preset_name: a key of `ndf_mi.field.PRESETS`.
        entries: NAME=VALUE, where VALUE is JSON or, for text, the text itself. Later entries override earlier
            ones and the arguments below.
        ablation_name: a key of `ndf_mi.learn.ablations.ABLATIONS`.
        steps, seconds, seed, refine, camera_colours: training options; None keeps the default. With `seconds`
            alone, steps are unlimited.
        integrator: `ndf_quadrature`, or a scattering integrator, which changes the preset so that colours
            contain no light and sets a number of steps of its own.
        planned: replaces the named preset; `preset_name` then only selects the training options.

    Raises:
        InputError: which entry is wrong, and why.
    """
    check_integrator(integrator)
    if seconds is not None and not seconds > 0:
        raise InputError("--seconds", f"{seconds:g}", "a time above 0")
    training = TrainingOptions.paper() if preset_name == "paper" else TrainingOptions()
    base, training = ablation(ablation_name).apply(planned or preset(preset_name), training)
    if integrator != QUADRATURE:
        base = relightable(base)[0]
        steps_in_all = training.warm_up + SCATTERING_STEPS
        training = dataclasses.replace(training, integrator=integrator, steps=steps_in_all)
    if steps is None and seconds is not None:
        steps = UNLIMITED
    given = {"steps": steps, "seconds": seconds, "seed": seed, "refine": refine,
             "camera_colours": camera_colours}
    changes: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    for text in entries:
        name, equals, value = text.partition("=")
        name = rename_entry(name.strip().replace("-", "_"), {**PRESET_FIELDS, **TRAINING_FIELDS})
        if not equals or name not in NAMES:
            raise InputError("--option", repr(text), "NAME=VALUE, NAME one of " + ", ".join(NAMES))
        kind = Preset if name in _ARCHITECTURE else TrainingOptions
        parsed = _parsed(value)
        if isinstance(parsed, str):
            parsed = rename_entry(parsed, PRESET_VALUES.get(name, {}))
        changes[name] = option_value(kind, name, parsed, "--option")
    architecture = {name: value for name, value in changes.items() if name in _ARCHITECTURE}
    options = {name: value for name, value in changes.items() if name in _TRAINING}
    return dataclasses.replace(base, **architecture), dataclasses.replace(training, **options)


def _parsed(value: str) -> Any:
    """VALUE as JSON, or the text itself where it is none."""
    try:
        return json.loads(value)
    except (ValueError, RecursionError):
        return value
