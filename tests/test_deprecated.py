"""Old names keep working, each with one warning, and are absent from --help."""

from __future__ import annotations

import mitsuba as mi
import pytest

from ndf_mi import deprecated
from ndf_mi.deprecated import DeprecatedOption, rewrite_arguments
from ndf_mi.errors import InputError

OPTIONS = (
    DeprecatedOption("--old-name", "--new-name"),
    DeprecatedOption("--protocol", "--protocol", {"ours": ("--protocol", "default")}),
    DeprecatedOption("--offsets", "--methods", {"all": (), "none": ("--methods", "a,b")}),
)


@pytest.mark.parametrize(("given", "rewritten", "warned"), [
    (["RUN", "--old-name", "3"], ["RUN", "--new-name", "3"], ["--old-name", "--new-name"]),
    (["--old_name=3", "RUN"], ["--new-name", "3", "RUN"], ["--old-name", "--new-name"]),
    (["--old-name"], ["--old-name"], []),
    (["--protocol", "ours", "RUN"], ["--protocol", "default", "RUN"], ["--protocol ours", "default"]),
    (["--protocol=ours"], ["--protocol", "default"], ["--protocol ours"]),
    (["--offsets", "none", "RUN"], ["--methods", "a,b", "RUN"], ["--offsets none", "--methods a,b"]),
    (["--offsets=all", "RUN"], ["RUN"], ["--offsets all", "--methods"]),
    (["--protocol", "zju", "--new-name", "1"], ["--protocol", "zju", "--new-name", "1"], []),
])  # fmt: skip
def test_arguments(capsys, given, rewritten, warned):
    assert rewrite_arguments(given, OPTIONS) == rewritten
    error = capsys.readouterr().err
    assert all(text in error for text in warned)
    assert len(error.splitlines()) == error.count("deprecated") == bool(warned)


@pytest.mark.parametrize(("given", "facts"), [
    (["--offsets", "some"], ("--offsets", "'some'", "all, none", "--methods")),
    (["--offsets", "all", "--methods", "a"], ("--offsets", "--methods")),
    (["--old-name", "3", "--new-name=4"], ("--old-name", "--new-name")),
])  # fmt: skip
def test_refusals(given, facts):
    with pytest.raises(InputError) as error:
        rewrite_arguments(given, OPTIONS)
    assert all(fact in str(error.value) for fact in facts)


def test_each_name_warns_once(capsys):
    for _ in range(3):
        rewrite_arguments(["--old-name", "3"], OPTIONS)
    deprecated.rename_entry("strata", deprecated.PRESET_FIELDS)
    assert len(capsys.readouterr().err.splitlines()) == 2


def test_entries_of_files(capsys):
    found = deprecated.rename_entries({"old": 1, "kept": 2}, {"old": "new"})
    assert found == {"new": 1, "kept": 2}
    assert deprecated.rename_entries({"new": 3, "old": 1}, {"old": "new"}) == {"new": 3}
    found = deprecated.rename_entries({"old": "a", "kept": "a"}, {"old": "new"}, {"new": {"a": "b"}})
    assert found == {"new": "b", "kept": "a"}
    assert capsys.readouterr().err == ""


def test_parameter_of_a_plugin(capsys):
    props = mi.Properties("plugin")
    props["lattice"] = 0.5
    deprecated.rename_parameter(props, "plugin", "lattice", "spacing")
    deprecated.rename_parameter(props, "plugin", "absent", "other")
    assert props["spacing"] == 0.5 and "lattice" not in props and "other" not in props
    assert "plugin: parameter lattice is deprecated: use spacing" in capsys.readouterr().err
    props["lattice"] = 0.25
    with pytest.raises(InputError, match="plugin: lattice.*spacing"):
        deprecated.rename_parameter(props, "plugin", "lattice", "spacing")
