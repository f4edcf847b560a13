"""How methods are found and how the command line names them."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from ndf_mi.errors import InputError
from ndf_mi.methods import registry
from ndf_mi.methods.base import Budget, expect_views
from ndf_mi.methods.registry import MethodSpec, parse_spec, parse_specs


@pytest.fixture
def grey():
    @registry.register
    class Grey:
        key, label = "grey", "Grey"

        def __init__(self, texture=3):
            self.texture = texture

        def render(self, camera, frame):
            return np.full((camera.h, camera.w, 3), 0.5, dtype=np.float32)

    yield Grey
    registry.unregister("grey")


def test_a_registered_class_is_created_with_the_options_that_it_takes(grey):
    assert "grey" in registry.keys()
    assert registry.entry("grey").create({"texture": 5, "samples": 9}).texture == 5
    assert registry.entry("grey").create().texture == 3
    expect_views(registry.entry("grey").create(), [("any", 1)])


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """Writes a package with a module and an entry point `outside` of that value, as installing it would."""

    def install(code: str, value: str) -> None:
        (tmp_path / "outside_method.py").write_text(code)
        metadata = tmp_path / "outside_method-1.0.dist-info"
        metadata.mkdir()
        (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: outside-method\nVersion: 1.0\n")
        (metadata / "entry_points.txt").write_text(f"[ndf_mi.methods]\noutside = {value}\n")
        monkeypatch.syspath_prepend(tmp_path)

    yield install
    sys.modules.pop("outside_method", None)
    if "outside" in registry.keys():
        registry.unregister("outside")


def test_a_method_of_an_installed_package_needs_no_import(installed):
    installed("class Outside:\n    key, label = 'outside', 'Outside'\n", "outside_method:Outside")
    assert parse_spec("outside@converged") == MethodSpec("outside", None, "converged")
    assert registry.entry("outside").create({"texture": 5}).label == "Outside"
    with pytest.raises(InputError, match="gauss.*outside"):
        parse_spec("gauss")


@pytest.mark.parametrize(("code", "value", "facts"), [
    ("import no_such_module", "outside_method:Outside", "outside.*outside_method:Outside.*no_such_module"),
    ("", "outside_method:Outside", "outside.*AttributeError"),
    ("class Outside:\n    key = 'other'\n", "outside_method:Outside", "outside.*other"),
])
def test_a_package_that_cannot_be_loaded_is_named(installed, code, value, facts):
    installed(code, value)
    with pytest.raises(InputError, match=facts):
        parse_spec("outside")


@pytest.mark.parametrize("key", ["ndf", "mesh", "offset-mesh", "images"])
def test_built_in_methods_have_the_members_of_the_contract(key):
    method = registry.entry(key).create({"texture": 8, "samples": 4})
    assert method.key == key and method.label
    for member in ("fit", "render", "metadata", "cache_key", "save", "load"):
        assert callable(getattr(method, member))


@pytest.mark.parametrize(
    "text, spec, name",
    [
        ("mesh", MethodSpec("mesh"), "mesh"),
        (" mesh@equal-time", MethodSpec("mesh", None, "equal-time"), "mesh-equal-time"),
        ("offset-mesh@converged", MethodSpec("offset-mesh", None, "converged"), "offset-mesh-converged"),
        ("images:some/their system", MethodSpec("images", Path("some/their system")), "images-their-system"),
        ("ndf:C@B:x", MethodSpec("ndf", Path("C@B:x")), "ndf-C-B-x"),
    ],
)
def test_a_method_is_read_from_the_command_line(text, spec, name):
    assert parse_spec(text) == spec and spec.name == name
    assert parse_spec(str(spec)) == spec


@pytest.mark.parametrize(
    "text, words",
    [
        ("gauss", ["gauss", "ndf, mesh, offset-mesh, ", ", images"]),
        ("", ["ndf"]),
        ("mesh@fast", ["fast", "converged", "equal-time"]),
        ("mesh@", ["converged", "equal-time"]),
        ("mesh@converged:folder", ["folder", "budget"]),
        ("mesh:folder@converged", ["folder", "budget"]),
        ("mesh:", ["empty"]),
        ("images", ["images:FOLDER"]),
        ("images@converged", ["images:FOLDER"]),
    ],
)
def test_what_cannot_be_read_is_named(text, words):
    with pytest.raises(InputError) as error:
        parse_spec(text)
    assert all(word in str(error.value) for word in words)


def test_lists_are_separated_by_commas_and_without_repetition():
    assert [spec.key for spec in parse_specs("ndf,mesh, images:x")] == ["ndf", "mesh", "images"]
    assert parse_specs(["images:a,b"])[0].folder == Path("a,b")
    with pytest.raises(InputError, match="images-x"):
        parse_specs("images:a/x,images:b/x")
    with pytest.raises(InputError, match="none"):
        parse_specs("")


@pytest.mark.parametrize(
    "wrong", [{"seconds": 0.0}, {"seconds": float("nan")}, {"seconds": float("inf")}, {"seed": -1}]
)
def test_a_budget_out_of_range_is_refused(wrong):
    with pytest.raises(InputError):
        Budget(**wrong)
