"""How many cores a process may use, where control groups say so."""

from pathlib import Path

import pytest

from ndf_mi import machine


def groups(root: Path, own: str, files: dict[str, str]) -> list[float]:
    """What is granted by those files under a root, to a process with such a list of groups."""
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    (root / "own").write_text(own)
    return machine._quotas(str(root), str(root / "own"))


def test_every_group_up_to_the_root_may_limit(tmp_path: Path) -> None:
    found = groups(tmp_path, "0::/pod/box\n", {"pod/box/cpu.max": "max 100000\n", "pod/cpu.max": "150000 100000\n", "cpu.max": "50 100\n"})
    assert found == [1.5, 0.5]


def test_groups_of_version_1(tmp_path: Path) -> None:
    found = groups(tmp_path, "3:cpuset:/\n2:cpu,cpuacct:/box\n0::/\n",
                   {"cpu,cpuacct/box/cpu.cfs_quota_us": "250000\n", "cpu,cpuacct/box/cpu.cfs_period_us": "100000\n",
                    "cpu,cpuacct/cpu.cfs_quota_us": "-1\n", "cpu,cpuacct/cpu.cfs_period_us": "100000\n"})
    assert found == [2.5]


def test_no_groups_no_limit(tmp_path: Path) -> None:
    assert groups(tmp_path, "0::/gone\n", {}) == [] == machine._quotas(str(tmp_path), str(tmp_path / "none"))


def test_no_more_cores_than_granted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "_quotas", lambda: [0.5])
    assert machine.describe()["Cores"] == "0.5"
    monkeypatch.setattr(machine, "_quotas", lambda: [])
    assert float(machine.describe()["Cores"]) >= 1
