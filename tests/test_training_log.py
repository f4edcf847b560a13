"""Reading the log of a training."""

import pytest

from ndf_mi.errors import InputError
from ndf_mi.training_log import FILE_NAME, read_training_log


def test_history(tmp_path):
    assert read_training_log(tmp_path) == []
    log = tmp_path / FILE_NAME
    log.write_text('{"step": 1}\n{"step": 2}\n{"st')
    assert [entry["step"] for entry in read_training_log(tmp_path)] == [1, 2]
    log.write_text('{"step": 1}\n[2]\n{"step": 3}\n')
    with pytest.raises(InputError) as caught:
        read_training_log(tmp_path)
    assert caught.value.where == f"{log}:2"
