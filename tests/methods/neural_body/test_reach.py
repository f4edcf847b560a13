"""How far a volume must reach, on bodies smaller than what the images show."""

import dataclasses

from sphere_capture import with_body

from ndf_mi.methods.neural_body.architecture import Architecture
from ndf_mi.methods.neural_body.reach import covered
from ndf_mi.methods.neural_body.volume import NeuralBodyVolume

SMALL = Architecture(voxel=0.02, padding=0.3, code=2, channels=(2, 2, 2, 2), depths=(1, 1, 1, 1), reach=1,
                     density_layers=(4,), latent=2)


def shrunk(capture, share):
    """The capture with a body of this share of the size that its images show."""
    vertices = capture.poses.vertices - (1 - share) * capture.body.template
    body = dataclasses.replace(capture.body, template=share * capture.body.template)
    return with_body(capture, body, dataclasses.replace(capture.poses, vertices=vertices))


def shares(capture):
    return covered(capture, NeuralBodyVolume(capture, SMALL)._placed, SMALL.padding)


def test_voxels_around_the_body_cover_what_they_reach(capture):
    # The sphere has a radius of 0.5 m. A stride's voxels reach at least one and at most 3.5 of their edges
    # beyond the body.
    assert min(shares(capture)) > 0.99
    for share in (0.8, 0.6):
        gap = 0.5 * (1 - share)
        found = shares(shrunk(capture, share))
        assert found == sorted(found)
        for number, part in enumerate(found, start=1):
            radius = [share * 0.5 + edges * 0.02 * 2**number for edges in (1, 3.5)]
            assert min(1, (radius[0] / 0.5) ** 2) - 0.05 < part < (radius[1] / 0.5) ** 2 + 0.05
        assert found[0] < 0.99 or gap < 0.14


def test_the_volume_reaches_as_far_as_the_masks(capture):
    asked = dataclasses.replace(SMALL, cover=0.99)
    assert NeuralBodyVolume(capture, asked)._reach == 1
    small = shrunk(capture, 0.6)
    enough = [number for number, share in enumerate(shares(small), start=1) if share >= 0.99]
    assert NeuralBodyVolume(small, asked)._reach == enough[0] > 1
    assert NeuralBodyVolume(small, SMALL)._reach == 1
