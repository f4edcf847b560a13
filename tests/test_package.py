"""What an installation contains: every folder of the library, plugins, scenes, data, the typing marker."""

from __future__ import annotations

import importlib.metadata
from importlib.resources import files
from pathlib import Path

import pytest

import ndf_mi
import ndf_mi.plugins

LIBRARY = Path(ndf_mi.__file__).parent


def test_every_folder_with_code_is_a_package():
    folders = {file.parent for file in LIBRARY.rglob("*.py")}
    assert [str(folder) for folder in folders if not (folder / "__init__.py").is_file()] == []


def test_every_plugin_module_is_listed():
    modules = {file.stem for file in Path(ndf_mi.plugins.__file__).parent.glob("*.py")} - {"__init__"}
    plugins = {name for name in modules if not name.startswith("_")}
    assert set(ndf_mi.plugins.MODULES) == plugins


def test_data_lie_next_to_the_code():
    assert (files("ndf_mi") / "py.typed").is_file()
    assert any(file.name.endswith(".bvh") for file in (files("ndf_mi.body") / "data").iterdir())


def test_every_file_next_to_the_code_is_installed(monkeypatch):
    pytest.importorskip("setuptools")
    from distutils.core import run_setup

    monkeypatch.chdir(LIBRARY.parent)
    build = run_setup("setup.py", stop_after="init").get_command_obj("build_py")
    build.ensure_finalized()
    installed = {Path(folder, name) for _, folder, _, names in build.data_files for name in names}
    others = [file for file in LIBRARY.rglob("*") if file.is_file() and file.suffix not in (".py", ".pyc")]
    assert {file.relative_to(LIBRARY.parent) for file in others} <= installed


def test_there_is_one_version():
    assert importlib.metadata.version("ndf-mi") == ndf_mi.__version__
