"""LPIPS: what its network is given, and what is printed where it is missing. The network is a stand-in."""

from __future__ import annotations

import contextlib
import importlib.machinery
import sys
from types import ModuleType

import numpy as np
import pytest

from ndf_mi.experiments import metrics, perceptual


class Difference:
    """Stands for the network: the mean difference, of which it remembers the inputs."""

    def __init__(self, net: str, verbose: bool) -> None:
        assert net == "alex" and not verbose
        self.seen: list[np.ndarray] = []

    def eval(self) -> Difference:
        return self

    def __call__(self, one: np.ndarray, other: np.ndarray) -> np.ndarray:
        self.seen = [one, other]
        return np.abs(one - other).mean(keepdims=True)


@pytest.fixture
def module(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    made = {name: ModuleType(name) for name in ("lpips", "torch")}
    for name, each in made.items():
        each.__spec__ = importlib.machinery.ModuleSpec(name, None)
        monkeypatch.setitem(sys.modules, name, each)
    monkeypatch.setattr(made["lpips"], "LPIPS", Difference, raising=False)
    monkeypatch.setattr(made["torch"], "from_numpy", np.asarray, raising=False)
    monkeypatch.setattr(made["torch"], "no_grad", contextlib.nullcontext, raising=False)
    for cached in (perceptual._network, perceptual.absence):
        cached.cache_clear()
    yield made["lpips"]
    for cached in (perceptual._network, perceptual.absence):
        cached.cache_clear()


def test_images_are_scaled_and_padded(module: ModuleType) -> None:
    white, black = np.ones((80, 40, 3), np.float32), np.zeros((80, 40, 3), np.float32)
    assert perceptual.absence() == ""
    # Of 64 columns 40 differ by 2, the range of what the network takes.
    assert perceptual.lpips(white, black) == pytest.approx(2 * 40 / 64)
    one, other = perceptual._network().seen
    assert one.shape == (1, 3, 80, 64) and (one.max(), other.min(), other.max()) == (1, -1, -1)
    assert one.flags.c_contiguous and one.dtype == np.float32


def test_only_the_box_counts(module: ModuleType) -> None:
    truth, mask = np.zeros((90, 90, 3)), np.zeros((90, 90), bool)
    mask[5:85, 10:80] = True
    outside = np.where(mask[..., None], truth, 1.0)
    assert metrics.measure(truth, outside, mask)["box_lpips"] == 0
    assert metrics.measure(truth, truth + 0.5, mask)["box_lpips"] == pytest.approx(1)


def test_its_absence_is_said(monkeypatch: pytest.MonkeyPatch, module: ModuleType) -> None:
    def broken(**_: object) -> None:
        raise OSError("no weights at alexnet.pth\nsecond line")

    monkeypatch.setattr(module, "LPIPS", broken)
    assert "cannot be loaded (no weights at alexnet.pth). pip install lpips" in perceptual.absence()
    perceptual.absence.cache_clear()
    monkeypatch.delitem(sys.modules, "lpips")
    monkeypatch.setattr(perceptual.importlib.util, "find_spec", lambda name: None)
    assert perceptual.absence().endswith("pip install lpips.")
    truth = np.zeros((20, 20, 3))
    assert metrics.measure(truth, truth, np.ones((20, 20), bool))["box_lpips"] is None
