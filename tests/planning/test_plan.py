"""Plans on disk."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.planning.plan import Plan, read_preset


def test_a_plan_reads_back_and_is_valid_for_one_capture(planned: Plan, capture: Capture,
                                                           tmp_path: Path) -> None:
    file = tmp_path / "plan.json"
    planned.write(file)
    preset, value = read_preset(file, capture.digest, "body")
    assert preset == planned.preset and value == json.loads(json.dumps(planned.to_dict()))
    with pytest.raises(InputError, match="digest"):
        read_preset(file, "another", "body")
    with pytest.raises(InputError, match="surface"):
        read_preset(file, capture.digest, "offset")
    with pytest.raises(InputError, match="no such file"):
        read_preset(tmp_path / "none.json", capture.digest, "body")
    for change in ({"format": "x"}, {"version": 9}, {"preset": 3}, {"preset": {"x": 1}}):
        file.write_text(json.dumps(value | change))
        with pytest.raises(InputError, match=next(iter(change))):
            read_preset(file, capture.digest, "body")
    file.write_text("{")
    with pytest.raises(InputError, match="cannot be read"):
        read_preset(file, capture.digest, "body")
