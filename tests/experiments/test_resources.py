"""What a method takes: memory by a known allocation, size by known files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ndf_mi.experiments import resources
from ndf_mi.experiments.resources import peak_memory, size_on_disk


@pytest.mark.skipif(not resources.CLEAR.exists(), reason="needs Linux")
def test_the_peak_is_that_of_the_work_alone() -> None:
    def take(megabytes: int) -> None:
        np.ones(megabytes << 20, np.uint8).sum()

    before = peak_memory(lambda: None)
    large, small = peak_memory(lambda: take(400)), peak_memory(lambda: take(10))
    assert before is not None and large is not None and small is not None
    assert 380 << 20 < large - before < 450 << 20
    assert small < large - (350 << 20)


def test_without_such_files_the_work_is_done_all_the_same(monkeypatch: pytest.MonkeyPatch,
                                                          tmp_path: Path) -> None:
    monkeypatch.setattr(resources, "CLEAR", tmp_path / "none" / "clear_refs")
    done: list[int] = []
    assert peak_memory(lambda: done.append(1)) is None and done == [1]


def test_the_size_is_that_of_what_rendering_needs() -> None:
    class Saved:
        key = label = "saved"

        def save(self, folder: Any) -> None:
            (Path(folder) / "part").mkdir()
            (Path(folder) / "part" / "weights.bin").write_bytes(bytes(1234))
            (Path(folder) / "poses.npz").write_bytes(bytes(99))

        def fit(self, *_: Any) -> None: ...

        def load(self, *_: Any) -> None: ...

        def metadata(self) -> dict[str, Any]:
            return {}

    assert size_on_disk(Saved()) == 1234
