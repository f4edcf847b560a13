"""The command line that repeats a call is read back as the same call."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest
import tyro

from ndf_mi.commands.ablate import Ablate
from ndf_mi.commands.command_line import command_line
from ndf_mi.commands.compare import Compare
from ndf_mi.commands.relight import Relight
from ndf_mi.commands.tradeoff import Tradeoff

RUN, CAPTURE, OUT = Path("a run"), Path("capture"), Path("out")


@pytest.mark.parametrize(
    ("name", "command", "words"),
    [
        ("compare", Compare(RUN, CAPTURE), 5),
        (
            "compare",
            Compare(RUN, CAPTURE, methods="ndf,images:my pictures", out=OUT, max_images=3, protocol="zju"),
            13,
        ),
        ("ablate", Ablate(CAPTURE, OUT, only=("no-pose", "naked"), option=("rays=96", "band=0.12")), 12),
        ("relight", Relight(RUN, CAPTURE, OUT, grid_spacing=0.0125), 9),
        ("tradeoff", Tradeoff(RUN, CAPTURE, OUT, only=("samples", "size"), seconds=1.5), 12),
    ],
)
def test_it_is_read_back_as_the_same_call(name, command, words):
    line = shlex.split(command_line(name, command))
    assert line[:2] == ["ndf-mi", name] and len(line) == words
    assert tyro.cli(type(command), args=line[2:]) == command
