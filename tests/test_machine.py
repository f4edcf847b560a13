"""How many cores a process may use according to its control groups."""

from __future__ import annotations

from pathlib import Path

from ndf_mi import machine


def quotas(root: Path, own: str, files: dict[str, str]) -> list[float]:
    """The quotas that these files under `root` give a process with that list of groups."""
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    (root / "own").write_text(own)
    return machine.cpu_quotas(root, root / "own")


def test_every_group_up_to_the_root_may_limit(tmp_path: Path) -> None:
    files = {"pod/box/cpu.max": "max 100000\n", "pod/cpu.max": "150000 100000\n", "cpu.max": "50 100\n"}
    assert quotas(tmp_path, "0::/pod/box\n", files) == [1.5, 0.5]


def test_groups_of_version_1(tmp_path: Path) -> None:
    files = {"cpu,cpuacct/box/cpu.cfs_quota_us": "250000\n", "cpu,cpuacct/box/cpu.cfs_period_us": "100000\n",
             "cpu,cpuacct/cpu.cfs_quota_us": "-1\n", "cpu,cpuacct/cpu.cfs_period_us": "100000\n"}
    assert quotas(tmp_path, "3:cpuset:/\n2:cpu,cpuacct:/box\n0::/\n", files) == [2.5]


def test_no_groups_no_limit(tmp_path: Path) -> None:
    assert quotas(tmp_path, "0::/gone\n", {}) == [] == machine.cpu_quotas(tmp_path, tmp_path / "none")


def test_no_more_cores_than_granted() -> None:
    assert machine.usable_cores([2.0, 0.5]) == 0.5
    assert machine.usable_cores([]) >= 1


def test_description_names_hardware_variant_and_versions() -> None:
    described = machine.describe()
    assert float(described["Cores"]) > 0 and described["Variant"]
    assert all(name in described["Versions"] for name in ("ndf-mi", "Mitsuba", "Dr.Jit", "LLVM", "Python"))
