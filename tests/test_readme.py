"""The README's Python runs as printed, in a process of its own; its commands exist."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import mitsuba as mi
import pytest

from ndf_mi.commands import find

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_python_runs_as_printed(make_run, tmp_path):
    make_run("demo/run", frames=4)
    shutil.copytree(ROOT / "scenes", tmp_path / "scenes")
    code = "\n".join(re.findall(r"```python\n(.*?)```", README, re.S)).replace("llvm_ad_rgb", mi.variant())
    assert "mi.load_file" in code and "opt.step()" in code
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "performer.png").stat().st_size > 100


@pytest.mark.parametrize("command", sorted(set(re.findall(r"ndf-mi ([a-z]+(?: (?:synthesise|check|import))?)", README))))
def test_commands_exist(command):
    assert find(command.split()) is not None
