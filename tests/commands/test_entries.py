"""Every command that is listed exists and can explain itself."""

from __future__ import annotations

import pytest

from ndf_mi import commands


@pytest.mark.parametrize("entry", commands.ENTRIES, ids=lambda entry: entry.name)
def test_help(capsys, entry):
    assert commands.main([*entry.name.split(), "--help"]) == 0
    assert f"ndf-mi {entry.name}" in capsys.readouterr().out
