"""The command that runs the stability suite: selection, rows, exit codes and files."""

from __future__ import annotations

import json
import re
import sys

import pytest

from ndf_mi.commands import main
from ndf_mi.commands.stability import SUBJECTS


def listed(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, str]:
    """The subjects of the cases that `--list` prints, by the cases' names."""
    assert main(["stability", "--list", *arguments]) == 0
    lines = capsys.readouterr().out.splitlines()
    return {name: subject for subject, name, _ in (line.split(maxsplit=2) for line in lines)}


def test_every_subject_has_cases_in_order(capsys):
    cases = listed(capsys)
    assert list(dict.fromkeys(cases.values())) == list(SUBJECTS)
    assert len(cases) == 42
    quick = listed(capsys, "--quick")
    assert quick.keys() < cases.keys() and "learning-rates" not in quick
    assert listed(capsys, "--only", "bodies", "losses") == {
        "rotations": "bodies", "skinned-bodies": "bodies", "losses": "learning"}


def test_a_case_within_its_tolerance(tmp_path, capsys):
    assert main(["stability", "--only", "masks-of-one-pixel", "-o", str(tmp_path / "t.json")]) == 0
    assert re.search(r"^masks-of-one-pixel .*within", capsys.readouterr().out, re.MULTILINE)
    (case,) = json.loads((tmp_path / "t.json").read_text())["cases"]
    assert case["within"] and case["subject"] == "images" and len(case["measured"]) == 9


@pytest.mark.parametrize(("arguments", "named"), [
    (["--only", "no-such"], "no-such"), (["-o", "table.csv"], "table.csv"),
    (["--quick", "--only", "learning-rates"], "learning-rates")])
def test_mistakes_are_named(arguments, named, capsys):
    assert main(["stability", *arguments]) == 2
    assert named in capsys.readouterr().err


def test_a_missing_package_is_named_with_the_command_that_installs_it(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "pytest", None)
    assert main(["stability", "--list"]) == 2
    printed = capsys.readouterr().err
    assert "pytest" in printed and 'pip install "ndf-mi[stability]"' in printed
