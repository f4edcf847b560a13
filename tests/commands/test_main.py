"""The command line: which command runs, and its exit code."""

from __future__ import annotations

import subprocess
import sys
import types
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import pytest
from tyro.conf import Positional

import ndf_mi
from ndf_mi import commands
from ndf_mi.deprecated import DeprecatedOption
from ndf_mi.errors import InputError


@dataclass
class Fake:
    """A command for the tests."""

    path: Positional[Path]
    """What is read."""
    steps: int = 3
    """How many."""
    deprecated: ClassVar = (DeprecatedOption("--number", "--steps"),)

    def run(self) -> int | None:
        match self.path.name:
            case "bad":
                raise InputError(self.path, "nothing", "something", "make it")
            case "interrupted":
                raise KeyboardInterrupt
            case "bug":
                raise ZeroDivisionError
        return self.steps if self.path.name == "code" else None


@pytest.fixture(autouse=True)
def fake_command(monkeypatch):
    module = types.ModuleType("ndf_mi.commands.fake")
    module.Fake = Fake
    monkeypatch.setitem(sys.modules, "ndf_mi.commands.fake", module)
    entries = tuple(
        commands.Entry(name, "fake", "Fake", "a command for the tests", variant=False)
        for name in ("try it", "try")
    )
    monkeypatch.setattr(commands, "ENTRIES", entries)


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (["try", "fine"], 0),
        (["try", "it", "fine"], 0),
        (["try", "code", "--steps", "7"], 7),
        (["try", "bad"], 2),
        (["try", "interrupted"], 130),
        (["try"], 2),
        (["try", "fine", "--steps", "many"], 2),
        (["try", "fine", "--unknown", "1"], 2),
        (["try", "--help"], 0),
        (["nonsense"], 2),
        ([], 2),
        (["--help"], 0),
        (["--version"], 0),
    ],
)
def test_exit_codes(capsys, arguments, code):
    assert commands.main(arguments) == code
    out, err = capsys.readouterr()
    assert "Traceback" not in out + err
    assert bool(err) == (code in (2, 130))


def test_mistake_is_one_plain_message(capsys):
    commands.main(["try", "bad"])
    assert capsys.readouterr().err == "ndf-mi: error: bad: found nothing; expected something\n  make it\n"


def test_bug_is_not_hidden():
    with pytest.raises(ZeroDivisionError):
        commands.main(["try", "bug"])


def test_options_are_documented(capsys):
    commands.main(["try", "it", "--help"])
    out = capsys.readouterr().out
    for text in ("ndf-mi try it", "What is read.", "How many.", "A command for the tests."):
        assert text in out


def test_renamed_options_are_accepted_and_not_shown(capsys):
    assert commands.main(["try", "code", "--number", "7"]) == 7
    error = capsys.readouterr().err
    assert "--number" in error and "--steps" in error and len(error.splitlines()) == 1
    commands.main(["try", "--help"])
    assert "--number" not in capsys.readouterr().out


def test_a_reader_that_leaves_early_is_no_error():
    """As in ``ndf-mi --help | head -1``: the pipe is closed before anything is written."""
    process = subprocess.Popen(
        [
            sys.executable,
            "-c",
            "import sys; from ndf_mi.commands import console; sys.argv[1:] = ['--help']; "
            "sys.stdin.read(); sys.exit(console())",
        ],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    process.stdout.close()
    process.stdin.close()
    assert process.wait() == 141
    assert process.stderr.read() == b""


def test_installed_entry_point():
    tool = Path(sys.executable).with_name("ndf-mi")
    result = subprocess.run([tool, "--version"], capture_output=True, text=True)
    assert (result.returncode, result.stdout) == (0, f"ndf-mi {ndf_mi.__version__}\n")
    result = subprocess.run([tool, "capture"], capture_output=True, text=True)
    assert (
        result.returncode == 2 and "capture check" in result.stderr and "render a scene" not in result.stderr
    )
