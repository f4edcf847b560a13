"""Packages that come with extras: what is printed where one is missing."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from ndf_mi import doctor, optional
from ndf_mi.errors import InputError


def test_an_installed_package_is_imported() -> None:
    assert optional.require("json", extra="any") is sys.modules["json"]


def test_a_missing_package_is_named_with_the_command_that_installs_it() -> None:
    with pytest.raises(InputError) as raised:
        optional.require("surely_not_there.part", extra="atlas")
    assert "surely_not_there" in raised.value.where
    assert raised.value.repair == 'pip install "ndf-mi[atlas]"'


def test_an_error_inside_a_package_is_not_a_missing_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "broken_package.py").write_text("import surely_not_there")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ModuleNotFoundError, match="surely_not_there"):
        optional.require("broken_package", extra="atlas")


def test_requirements_are_those_of_the_metadata(monkeypatch: pytest.MonkeyPatch) -> None:
    lines = ["numpy>=2.2", "libigl<3,>=2.6; extra == 'atlas'", 'imageio>=2.34; extra == "video"',
             "ndf-mi[atlas,video]; extra == 'all'"]
    monkeypatch.setattr("importlib.metadata.requires", lambda name: lines)
    assert optional.requirements() == {"": ["numpy"], "atlas": ["libigl"], "video": ["imageio"]}
    assert optional.missing_packages(["numpy", "surely-not-there"]) == ["surely-not-there"]


def test_every_extra_is_described_and_part_of_all() -> None:
    tomllib = pytest.importorskip("tomllib")  # since Python 3.11
    project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())["project"]
    extras = set(project["optional-dependencies"]) - {"all", "bench", "dev"}
    assert extras == set(doctor.EXTRAS)
    assert project["optional-dependencies"]["all"] == [f"ndf-mi[{','.join(sorted(extras))}]"]
