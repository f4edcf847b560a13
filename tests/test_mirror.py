"""Every module has tests where one looks for them: in the folder of tests that mirrors its package."""

from __future__ import annotations

from pathlib import Path

import pytest
from import_graph import GRAPH, MODULES, imports

import ndf_mi.plugins
from ndf_mi.commands import ENTRIES

TESTS = Path(__file__).parent
BY_NAME = {
    "ndf_mi.commands": {f"ndf_mi.commands.{entry.module}" for entry in ENTRIES},
    "ndf_mi.plugins": {f"ndf_mi.plugins.{name}" for name in ndf_mi.plugins.MODULES},
}
"""What packages import by name."""

ELSEWHERE = {
    "ndf_mi.experiments.relight": "experiments/test_relight.py",
    "ndf_mi.field.sample": "render/test_quadrature.py",
    "ndf_mi.render.output": "commands/test_render.py",
    "ndf_mi.render.surfaces": "plugins/test_ndf_path.py",
    "ndf_mi.render.properties": "plugins/test_plugins.py",
    "ndf_mi.unpickle_records": "test_unpickle.py",
}
"""Modules that tests of another module cover."""


def package(module: str) -> str:
    """The package at the top that a module belongs to; the module itself where it stands at the root."""
    return ".".join(module.split(".")[:2])


def mirrors(part: str) -> list[Path]:
    """The files of tests that mirror a package, or a module at the root."""
    name = part.removeprefix("ndf_mi.")
    return [*(TESTS / name).rglob("*.py"), *TESTS.glob(f"test_{name}.py")]


def reached(part: str) -> set[str]:
    """The modules of a package that its tests import, or that these import within the package."""
    known: set[str] = set()
    waiting = {module for file in mirrors(part) for module in imports("", file)} | {part}
    while waiting:
        module = waiting.pop()
        if module in MODULES and module not in known and package(module) == part:
            known.add(module)
            waiting |= GRAPH[module] | BY_NAME.get(module, set())
    return known


@pytest.mark.parametrize("part", sorted({package(module) for module in MODULES} - {"ndf_mi"}))
def test_every_module_is_tested_in_the_mirror_of_its_package(part: str) -> None:
    modules = {name for name, file in MODULES.items() if package(name) == part and file.name != "__init__.py"}
    assert modules - reached(part) - set(ELSEWHERE) == set()


def test_what_is_covered_elsewhere_is() -> None:
    assert [
        name for name, file in ELSEWHERE.items() if name not in MODULES or not (TESTS / file).is_file()
    ] == []


def test_every_folder_of_tests_mirrors_a_package() -> None:
    parts = {part.removeprefix("ndf_mi.") for part in map(package, MODULES)}
    folders = {folder.name for folder in TESTS.iterdir() if folder.is_dir() and any(folder.glob("test_*.py"))}
    assert folders <= parts
