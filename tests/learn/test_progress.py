"""Errors as decibels."""

import pytest

from ndf_mi.learn.progress import Progress


def test_errors_are_decibels_where_there_are_any():
    progress = Progress(step=3, seconds=1.0, error=0.01, box_error=float("nan"), evaluated=7, kept_error=1e-3)
    assert progress.psnr == pytest.approx(20) and progress.kept_psnr == pytest.approx(30)
    assert progress.box_psnr is None and progress.held_back_psnr is None
