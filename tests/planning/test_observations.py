"""Observations show the place on the body that their pixel shows."""

from __future__ import annotations

import numpy as np

from ndf_mi.capture.capture import Capture
from ndf_mi.planning.observations import chosen_frames, observe


def test_observations_have_the_colour_of_their_place_on_the_body(capture: Capture) -> None:
    frames = chosen_frames(capture, 24)
    seen, views = observe(capture, frames)
    assert len(views) == len(capture.splits["train"])
    # The texture that the fixture draws the sphere with.
    u, v = 2 * np.pi * seen.uv[:, 0], seen.uv[:, 1]
    drawn = np.stack([0.5 + 0.3 * np.sin(u), 0.2 + 0.6 * v, 0.5 + 0.3 * np.cos(2 * u) * np.sin(np.pi * v)],
                     -1)
    assert np.abs(seen.colour - drawn).mean() < 0.02
    np.testing.assert_allclose(np.linalg.norm(seen.rest, axis=1), 0.5, atol=0.01)
    # The sphere only shifts, so its normals do not turn.
    assert np.abs(seen.shading).max() < 1e-5
    assert (np.sum(seen.normal * seen.to_camera, axis=1) > 0.3).all()
