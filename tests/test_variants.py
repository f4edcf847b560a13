"""Which variant is taken, and that plugins are registered whenever one is set."""

from __future__ import annotations

import os
import subprocess
import sys

import mitsuba as mi
import pytest

from ndf_mi import variants
from ndf_mi.errors import InputError


def test_preference(monkeypatch):
    monkeypatch.delenv(variants.VARIABLE, raising=False)
    cases = ((True, True, "cuda_ad_rgb"), (False, True, "llvm_ad_rgb"), (True, False, "cuda_ad_rgb"))
    for cuda, llvm, expected in cases:
        monkeypatch.setattr(variants, "cuda_usable", lambda cuda=cuda: cuda)
        monkeypatch.setattr(variants, "llvm_usable", lambda llvm=llvm: llvm)
        assert variants.preferred() == expected
    monkeypatch.setattr(variants, "cuda_usable", lambda: False)
    monkeypatch.setattr(variants, "llvm_usable", lambda: False)
    with pytest.raises(InputError, match="LLVM 17"):
        variants.preferred()


@pytest.mark.parametrize("name", ["llvm", "scalar_rgb", "cuda_ad_rgb"])
def test_environment_is_checked(monkeypatch, name):
    monkeypatch.setenv(variants.VARIABLE, name)
    monkeypatch.setattr(variants, "cuda_usable", lambda: False)
    with pytest.raises(InputError, match=variants.VARIABLE):
        variants.preferred()


def test_active_variant_stays():
    active = mi.variant()
    assert variants.use() == active == variants.use(active)
    other = next(name for name in variants.SUPPORTED if name != active)
    with pytest.raises(InputError, match="variant: .*active"):
        variants.use(other)


@pytest.mark.parametrize("order", ["import ndf_mi; mi.set_variant(v)", "mi.set_variant(v); import ndf_mi"])
def test_plugins_are_registered_in_either_order(order):
    code = f"""
import sys, types
calls = []
plugins = types.ModuleType("ndf_mi.plugins")
plugins.register = lambda: calls.append(mi.variant())
sys.modules["ndf_mi.plugins"] = plugins
import mitsuba as mi
v = sys.argv[1]
{order}
assert calls == [v], calls
mi.set_variant("scalar_rgb")
assert calls == [v], calls
"""
    result = subprocess.run(
        [sys.executable, "-c", code, mi.variant()], capture_output=True, text=True, env=os.environ
    )
    assert result.returncode == 0, result.stderr


def test_broken_drjit_is_a_plain_message(tmp_path):
    """Dr.Jit answers a missing system library with a NameError; the command names it and exits with 2."""
    (tmp_path / "drjit.py").write_text(
        "try:\n    raise ImportError('libatomic.so.1: cannot open')\nexcept ImportError:\n    undefined\n"
    )
    code = "from ndf_mi.commands import main; sys.exit(main(['render', 'x']))"
    code = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); {code}"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.returncode == 2
    assert result.stderr.startswith("ndf-mi: error: ") and "libatomic.so.1" in result.stderr
    assert "Traceback" not in result.stderr
