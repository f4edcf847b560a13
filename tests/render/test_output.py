"""Images to disk."""

import os
import subprocess
import sys

import numpy as np
import pytest

from ndf_mi.render.output import write_exr

ONE_CORE = """
import os, sys
os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
from ndf_mi import variants
variants.use()
import mitsuba as mi
import numpy as np
from ndf_mi.render.output import write_exr
write_exr(sys.argv[1], {"R": np.full((4, 3), 0.5)})
print(mi.Bitmap(sys.argv[1]).height())
"""


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"),
                    reason="the system cannot restrict a process to one core")
def test_exr_on_one_core(tmp_path):
    """Mitsuba needs a second thread to write and read it."""
    command = [sys.executable, "-c", ONE_CORE, str(tmp_path / "a.exr")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.strip() == "4"


def test_exr_channels(tmp_path):
    import mitsuba as mi

    channels = {"R": np.arange(12.0).reshape(3, 4), "depth.T": np.full((3, 4), 1e6), "A": np.ones((3, 4))}
    write_exr(tmp_path / "a.exr", channels)
    bitmap = mi.Bitmap(str(tmp_path / "a.exr"))
    found = {field.name: np.array(bitmap)[..., i] for i, field in enumerate(bitmap.struct_())}
    assert found.keys() == channels.keys() and all((found[name] == channels[name]).all() for name in channels)
