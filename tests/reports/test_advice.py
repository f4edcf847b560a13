"""Advice follows from the figures: who is best, who is level with the best, and what a cost gives up."""

from __future__ import annotations

import copy

from ndf_mi.experiments.records import MethodResult, Results
from ndf_mi.reports.advice import advice


def method(add_method, key: str, psnr: float, **metadata: object) -> MethodResult:
    result: MethodResult = add_method(key, key.capitalize(), 10 ** (-psnr / 20), **metadata)
    return result


def found(methods: list[MethodResult]) -> dict[str, str]:
    return {fact.label: " ".join(fact.lines) for fact in advice(Results({}, methods))}


def test_the_best_and_the_one_behind_it_are_named(add_method) -> None:
    said = found([method(add_method, "grey", 20.0), method(add_method, "blue", 26.0),
                  method(add_method, "red", 25.0)])
    assert said["Novel views"] == "Blue: 26.00 dB of box PSNR. Next is Red, 1.00 dB behind."
    assert said["Steady pictures in motion"].startswith("Blue: 29.00 dB of temporal PSNR.")
    # None says what it costs, and all pictures took as long.
    assert list(said) == ["Novel views", "Novel poses", "Steady pictures in motion"]


def test_methods_within_a_tenth_of_a_decibel_are_level(add_method) -> None:
    said = found([method(add_method, "blue", 25.95), method(add_method, "red", 26.0)])
    assert said["Novel poses"] == "Red and Blue: 26.00 dB of box PSNR and at most 0.05 dB less."


def test_the_cheapest_says_what_it_gives_up(add_method) -> None:
    said = found([method(add_method, "blue", 26.0, peak_memory=3_000_000_000, size_on_disk=18_000_000),
                  method(add_method, "red", 24.5, peak_memory=900_000_000, size_on_disk=18_000_000)])
    assert said["Little memory in training"] == (
        "Red: 900 MB, 1.50 dB behind the best on novel views and 1.50 dB behind the best on novel poses. "
        "The best in quality, Blue, takes 3.0 GB.")
    assert "Small files" not in said


def test_seeds_widen_what_counts_as_level(add_method) -> None:
    blue = [method(add_method, "blue", 26.0), method(add_method, "blue-seed1", 27.0)]
    for each in blue:
        each.group = "blue"
    said = found([*blue, method(add_method, "red", 26.0)])
    assert said["Novel views"] == "Blue and Red: 26.50 dB of box PSNR and at most 0.50 dB less."
    # Who is level with the best need not come before who is not.
    steady = method(add_method, "green", 26.2)
    said = found([method(add_method, "red", 26.7), steady, *blue])
    assert said["Novel views"] == ("Red and Blue: 26.70 dB of box PSNR and at most 0.20 dB less. "
                                   "Next is Green, 0.50 dB behind.")
    assert found([copy.copy(blue[0])]) == {}
