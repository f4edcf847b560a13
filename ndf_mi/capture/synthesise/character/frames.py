"""Which moments of a character's animations are the frames of a capture."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ndf_mi.capture.synthesise.character.animation import Animation
from ndf_mi.capture.synthesise.character.character import Character
from ndf_mi.capture.synthesise.plan import Settings
from ndf_mi.errors import InputError

#: The part of an animation that is for training where there is no other for the novel poses.
_TRAINING = 0.7
_RATE = 30.0


@dataclass(frozen=True)
class Span:
    """An animation from ``start`` to ``end``, seconds."""

    animation: Animation
    start: float
    end: float

    def evenly(self, count: int) -> np.ndarray:
        """(count,) seconds, in the middles of equal intervals."""
        return self.start + (np.arange(count) + 0.5) / max(count, 1) * (self.end - self.start)


def choose_spans(character: Character, training: str | None, novel: str | None) -> tuple[Span, Span]:
    """What is shown in training and in the novel poses: two animations, or two parts of one.

    Args:
        training, novel: names; by default the animation with most movement, and the one of the others with
            most movement per second.

    Raises:
        InputError: there is no such animation; the message lists those that there are.
    """
    found = {animation.name: animation for animation in character.animations}
    for option, name in (("--animation", training), ("--novel-animation", novel)):
        if name is not None and name not in found:
            raise InputError(option, repr(name), f"one of {', '.join(found)}")
    by_movement = sorted(found.values(), key=character.movement, reverse=True)
    first = next(a for a in by_movement if training in (None, a.name) and (training or novel != a.name
                                                                           or len(found) == 1))
    others = [a for a in by_movement if a is not first]
    second = found[novel] if novel else max(others or [first],
                                            key=lambda a: character.movement(a) / a.duration)
    if second is not first:
        return Span(first, first.start, first.end), Span(second, second.start, second.end)
    border = first.start + _TRAINING * first.duration
    return Span(first, first.start, border), Span(first, border, first.end)


def fitting(settings: Settings, novel: Span, notes: list[str]) -> Settings:
    """The settings with no more successive frames than the novel animation has at 30 Hz."""
    most = int((novel.end - novel.start) * _RATE + 1e-6) + 1
    if settings.sequence_frames <= most:
        return settings
    notes.append(f"The sequence has {most} frames, all of {novel.animation.name} at {_RATE:g} Hz.")
    return replace(settings, sequence_frames=most)


def transforms(character: Character, settings: Settings, training: Span, novel: Span) -> np.ndarray:
    """(T, N, 4, 4) nodes to world space in the frames of a capture: training, novel poses, sequence."""
    middle = (novel.start + novel.end - (settings.sequence_frames - 1) / _RATE) / 2
    sequence = max(middle, novel.start) + np.arange(settings.sequence_frames) / _RATE
    parts = [(training, training.evenly(settings.frames)), (novel, novel.evenly(settings.pose_frames)),
             (novel, sequence)]
    return np.concatenate([character.world(span.animation, times) for span, times in parts if len(times)])
