"""Choosing an LLVM: by the library's own word, never one that aborts, and before Dr.Jit looks."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import drjit as dr
import pytest

from ndf_mi import llvm

# Runs code in a fresh process in which LLVM is searched for in one folder alone.
PRELUDE = """
import importlib.util, os, sys
spec = importlib.util.spec_from_file_location("ndf_mi.llvm", sys.argv[1])
llvm = importlib.util.module_from_spec(spec)
sys.modules["ndf_mi.llvm"] = llvm
spec.loader.exec_module(llvm)
from pathlib import Path
llvm.folders = lambda: [Path(sys.argv[2])]
llvm.in_loader_cache = lambda: iter(())
"""

needs_llvm = pytest.mark.skipif(llvm.find() is None, reason="no LLVM on this machine")


def run_with_folder(folder: Path, code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", PRELUDE + code, llvm.__file__, str(folder)]
    kept = {key: value for key, value in os.environ.items() if key not in (llvm.VARIABLE, "NDF_MI_VARIANT")}
    return subprocess.run(command, capture_output=True, text=True, env={**kept, **environment})


@pytest.mark.parametrize(
    ("name", "version"),
    [
        ("libLLVM-15.so.1", (15, 0, 0)),
        ("libLLVM.so.19.1", (19, 1, 0)),
        ("libLLVM-14.0.6.so.1", (14, 0, 6)),
        ("libLLVM-17.so", (17, 0, 0)),
        ("libLLVM.so.22.1-rc1", (22, 1, 0)),
        ("libLLVM.so", None),
        ("libc.so.6", None),
    ],
)
def test_version_in_name(tmp_path, name, version):
    assert llvm.version_in_name(tmp_path / name) == version


def test_version_in_name_follows_links_and_folders(tmp_path):
    folder = tmp_path / "llvm-14" / "lib"
    folder.mkdir(parents=True)
    (folder / "libLLVM.so").touch()
    (tmp_path / "libLLVM.so.18.1").touch()
    (tmp_path / "libLLVM.so").symlink_to("libLLVM.so.18.1")
    assert llvm.version_in_name(folder / "libLLVM.so") == (14, 0, 0)
    assert llvm.version_in_name(tmp_path / "libLLVM.so") == (18, 1, 0)


@needs_llvm
def test_version_agrees_with_drjit():
    found = llvm.find()
    assert llvm.loaded() is not None and llvm.loaded().version == dr.detail.llvm_version()
    assert found.version >= llvm.loaded().version >= (llvm.MINIMUM, 0, 0)


@needs_llvm
def test_name_is_not_trusted_above_the_library(tmp_path):
    (tmp_path / "libLLVM.so").symlink_to(os.path.realpath(llvm.find().path))
    assert llvm.usable(tmp_path / "libLLVM.so").version == llvm.find().version


def test_unusable_files(tmp_path):
    for name in ("libLLVM.so.19.1", "libLLVM-16.so.1"):
        (tmp_path / name).write_bytes(b"\x7fELF not really")
        assert llvm.usable(tmp_path / name) is None
    assert llvm.usable(tmp_path / "absent.so") is None


def test_newest_usable_wins(monkeypatch, tmp_path):
    for name in (
        "libLLVM-15.so.1",
        "libLLVM.so.17.0",
        "libLLVM.so.21.1",
        "libLLVM.so.9.0",
        "libLLVM.so.22.0",
    ):
        (tmp_path / name).touch()
    monkeypatch.setattr(llvm, "folders", lambda: [tmp_path])
    monkeypatch.setattr(llvm, "in_loader_cache", lambda: iter(()))
    broken = {"libLLVM.so.22.0"}
    monkeypatch.setattr(
        llvm, "version_of", lambda path: None if Path(path).name in broken else llvm.version_in_name(path)
    )
    assert llvm.find() == llvm.Llvm((21, 1, 0), str(tmp_path / "libLLVM.so.21.1"))


def test_none_or_too_old_means_none(tmp_path):
    """Where only 15 and 16 exist, Dr.Jit finds nothing, and the message has the command to repair it."""
    (tmp_path / "libLLVM-15.so.1").touch()
    (tmp_path / "libLLVM-16.so.1").touch()
    code = """
import ndf_mi, drjit as dr
from ndf_mi import variants
from ndf_mi.errors import InputError
assert not dr.has_backend(dr.JitBackend.LLVM)
try:
    variants.use("llvm_ad_rgb")
except InputError as error:
    print(error)
"""
    result = run_with_folder(tmp_path, code)
    assert result.returncode == 0, result.stderr
    assert "LLVM 17 or newer" in result.stdout and llvm.install_command() in result.stdout


@needs_llvm
def test_unsuitable_choice_of_the_user_is_replaced(tmp_path):
    good = llvm.find().path
    (tmp_path / "libLLVM.so.19").symlink_to(good)
    code = "import ndf_mi, drjit as dr; print(bool(dr.has_backend(dr.JitBackend.LLVM)))"
    assert (
        run_with_folder(tmp_path, code, DRJIT_LIBLLVM_PATH=str(tmp_path / "gone.so")).stdout.strip() == "True"
    )
    assert run_with_folder(tmp_path / "none", code, DRJIT_LIBLLVM_PATH=good).stdout.strip() == "True"


def import_after_old_drjit(folder: Path) -> list[str]:
    code = """
import types
drjit = types.ModuleType("drjit")
drjit.detail = types.SimpleNamespace(llvm_version=lambda: (15, 0, 6))
sys.modules["drjit"] = drjit
import ndf_mi
"""
    result = run_with_folder(folder, code)
    assert result.returncode == 1
    message = result.stderr.strip().splitlines()[-2:]
    assert message[0].startswith("ImportError: Dr.Jit has loaded LLVM 15.0.6")
    return message


def test_old_llvm_loaded_before_import_is_refused(tmp_path):
    """Dr.Jit imported first, with 15: an ImportError that names the remedy, not an abort at the first
    render.
    """
    assert import_after_old_drjit(tmp_path)[1] == f"  Install one: {llvm.install_command()}"


@needs_llvm
def test_old_llvm_loaded_before_import_names_the_better_one(tmp_path):
    (tmp_path / "libLLVM.so.19").symlink_to(llvm.find().path)
    remedy = import_after_old_drjit(tmp_path)[1]
    assert "Import ndf_mi before drjit and mitsuba" in remedy
    assert remedy.endswith(f"or set {llvm.VARIABLE}={tmp_path / 'libLLVM.so.19'}")


def test_runs_by_itself():
    result = subprocess.run([sys.executable, "-I", llvm.__file__], capture_output=True, text=True)
    found = llvm.find()
    expected = (0, str(found)) if found else (1, llvm.install_command())
    assert (result.returncode, result.stdout.strip()) == expected
