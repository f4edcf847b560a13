"""What `import ndf_mi` imports: nothing that only some work needs. See also benchmarks/import_time.py."""

from __future__ import annotations

import subprocess
import sys

import pytest

#: Packages that only some work needs, by the names of their modules.
HEAVY = {
    "scipy",
    "skimage",
    "trimesh",
    "tyro",
    "rich",
    "matplotlib",
    "tensorboardX",
    "imageio",
    "imageio_ffmpeg",
    "PIL",
    "igl",
    "OpenEXR",
    "flip_evaluator",
}


def imported(before: str, code: str) -> set[str]:
    """The modules that `code` imports in a fresh process after `before`."""
    program = (
        f"import sys\n{before}\nknown = set(sys.modules)\n{code}\nprint(*sorted(set(sys.modules) - known))"
    )
    return set(
        subprocess.run(
            [sys.executable, "-c", program], capture_output=True, text=True, check=True
        ).stdout.split()
    )


@pytest.fixture(scope="module")
def bare() -> set[str]:
    return imported("import mitsuba", "import ndf_mi")


def test_the_package_imports_little_besides_mitsuba(bare: set[str]) -> None:
    own = {name for name in bare if name.partition(".")[0] == "ndf_mi"}
    assert own == {"ndf_mi", "ndf_mi.errors", "ndf_mi.llvm", "ndf_mi.variants"}
    others = {name.partition(".")[0].lstrip("_") for name in bare - own}
    # ctypes and subprocess find LLVM; they import more of the standard library.
    assert others <= {name.lstrip("_") for name in sys.stdlib_module_names}


def test_registering_the_plugins_imports_no_package_that_only_some_work_needs() -> None:
    from ndf_mi import variants

    found = imported("import mitsuba, ndf_mi", f"mitsuba.set_variant({variants.use()!r})")
    assert "ndf_mi.plugins.ndf" in found
    assert {name.partition(".")[0] for name in found} & HEAVY == set()
    unused = ("planning", "learn", "methods", "experiments", "reports", "capture", "commands", "animate")
    assert not {name for name in found if name.split(".")[:2] in (["ndf_mi", part] for part in unused)}
