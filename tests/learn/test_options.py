"""Training options: ranges are checked, and files of older versions read as what they were trained with."""

import dataclasses

import pytest

from ndf_mi.errors import InputError
from ndf_mi.learn.options import TrainingOptions


@pytest.mark.parametrize(("change", "option"), [
    ({"rays": 0}, "rays"), ({"mask_share": 2.0}, "mask-share"), ({"seed": -1}, "seed"),
    ({"atlas": "two"}, "atlas"),
    ({"min_transmittance": 1.0}, "min-transmittance"), ({"paths": 1}, "paths"),
    ({"steps": float("nan")}, "steps"),
    ({"integrator": "prbvolpath", "steps": 9}, "warm-up"),
])
def test_values_out_of_range_are_named(change, option):
    with pytest.raises(InputError, match=option):
        dataclasses.replace(TrainingOptions(), **change)


def test_older_files_are_read_as_they_were_meant():
    assert TrainingOptions.from_dict(TrainingOptions().to_dict()) == TrainingOptions()
    old = TrainingOptions().to_dict()
    old["skip_hidden"] = old.pop("min_transmittance") * 2
    assert TrainingOptions.from_dict(old) == dataclasses.replace(TrainingOptions(), min_transmittance=2e-3)
    before = {key: value for key,
              value in old.items() if key not in ("skip_hidden", "pose_noise", "opacity_edge")}
    read = TrainingOptions.from_dict(before)
    assert (read.min_transmittance, read.pose_noise, read.opacity_edge) == (0.0, 0.0, 0)
    with pytest.raises(InputError, match="training: .*sky"):
        TrainingOptions.from_dict({"sky": 1})
