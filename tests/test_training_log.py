"""Reading the log of a training."""

from __future__ import annotations

import pytest

from ndf_mi.errors import InputError
from ndf_mi.training_log import FILE_NAME, read_training_log


def test_an_incomplete_last_line_is_ignored_and_any_other_is_named(tmp_path):
    assert read_training_log(tmp_path) == []
    log = tmp_path / FILE_NAME
    log.write_text('{"step": 1}\n{"step": 2}\n{"st')
    assert [row["step"] for row in read_training_log(tmp_path)] == [1, 2]
    for wrong in ("nonsense", "[2]"):
        log.write_text(f'{{"step": 1}}\n{wrong}\n{{"step": 2}}\n')
        with pytest.raises(InputError, match=f"{FILE_NAME}:2"):
            read_training_log(tmp_path)
