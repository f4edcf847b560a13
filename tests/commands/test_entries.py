"""Every command in the list exists and prints its help."""

from __future__ import annotations

import pytest

from ndf_mi import commands
from ndf_mi.field import preset
from ndf_mi.learn.ablations import ABLATIONS
from ndf_mi.learn.options import TrainingOptions


@pytest.mark.parametrize("entry", commands.ENTRIES, ids=lambda entry: entry.name)
def test_help(capsys, entry):
    assert commands.main([*entry.name.split(), "--help"]) == 0
    assert f"ndf-mi {entry.name}" in capsys.readouterr().out


def test_help_lists_the_names_that_can_be_given(capsys):
    for arguments in (["ablate", "--only", "--help"], ["optimise", "--help"]):
        assert commands.main(arguments) == 0
        out = capsys.readouterr().out
        for name in (*ABLATIONS, *TrainingOptions().to_dict(), *(set(preset("fast").to_dict()) - {"name"})):
            assert name in out, name


@pytest.mark.parametrize(("name", "shown"), [
    ("capture import", "{zju,dynacap} DIR"), ("capture check", "DIR"), ("capture synthesise", "OUT"),
    ("optimise", "CAPTURE"), ("ablate", "CAPTURE"), ("compare", "RUN|CAPTURE"), ("animate", "RUN"),
    ("render", "SCENE_OR_RUN"),
])  # fmt: skip
def test_help_calls_folders_what_the_manual_calls_them(capsys, name, shown):
    commands.main([*name.split(), "--help"])
    assert capsys.readouterr().out.splitlines()[0].endswith(f" {shown}")


@pytest.mark.parametrize(("name", "option"), [("animate", "--camera"), ("optimise", "--option")])
def test_help_breaks_lines_where_they_are_full(capsys, monkeypatch, name, option):
    monkeypatch.setenv("COLUMNS", "110")
    commands.main([name, "--help"])
    lines = [line.strip("│ ") for line in capsys.readouterr().out.splitlines()]
    first = next(i for i, line in enumerate(lines) if line.startswith(option))
    last = next(i for i in range(first + 1, len(lines)) if lines[i].startswith("--"))
    assert min(map(len, lines[first + 1 : last - 1]), default=80) > 60
