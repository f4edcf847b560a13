"""Shape coefficients from text."""

from __future__ import annotations

import numpy as np
import pytest

from ndf_mi.animate.shape import parse_shape
from ndf_mi.errors import InputError
from ndf_mi.run import Run


def test_shapes_are_parsed_by_name_or_order(model_run: Run, make_run) -> None:
    body = model_run.body
    own = np.array([0.5, 0.25], np.float32)
    assert parse_shape("tall=-0.5", body, own).tolist() == [0.5, -0.5]
    assert parse_shape(" tall = 1 , wide=2", body, None).tolist() == [2, 1]
    assert parse_shape("3", body, own).tolist() == [3, 0.25] and own.tolist() == [0.5, 0.25]
    for text, message in (("thin=1", "thin.*wide, tall"),
                          ("1,2,3", "3.*at most 2"),
                          ("tall=x", "'x'"), ("1,tall=2", "NAME=NUMBER"), ("nan", "finite"),
                          ("", "finite")):  # fmt: skip
        with pytest.raises(InputError, match=message):
            parse_shape(text, body, own)
    with pytest.raises(InputError, match="--shape: .*skinning model"):
        parse_shape("1", make_run().body, None)
