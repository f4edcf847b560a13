"""The published sizes."""

from ndf_mi.field.presets import preset
from ndf_mi.methods.neural_body.architecture import Architecture
from ndf_mi.methods.neural_body.encoder import Encoder
from ndf_mi.methods.neural_body.method import PAPER


def affine(inputs, outputs):
    return inputs * outputs + outputs


def test_the_convolutions_are_the_published_ones():
    channels = [(16, 16)] * 2 + [(16, 32)] + [(32, 32)] * 2 + [(32, 64)] + [(64, 64)] * 3 + \
        [(64, 128)] + [(128, 128)] * 3 + [(128, 128)] + [(128, 128)] * 3
    assert [(inputs, outputs) for _, inputs, outputs, _ in Architecture().convolutions] == channels
    assert [stride for stride, _, _, down in Architecture().convolutions if down] == [1, 2, 3, 4]
    # Matrices without bias, and two numbers a channel of batch normalisation.
    assert Encoder(Architecture()).size == sum(27 * a * b + 2 * b for a, b in channels) == 3_790_592


def test_the_networks_are_the_published_ones():
    assert Architecture().features == 32 + 64 + 128 + 128 == 352
    density = affine(352, 256) + 2 * affine(256, 256) + affine(256, 1)
    colour = affine(256, 256) + affine(256 + 128, 256) + affine(256 + 27 + 63, 128) + affine(128, 3)
    layers = Architecture().layers()
    assert sum(layer.size for layer in layers.values()) == density + colour == 431_364
    assert layers["linear1"].pose == 128 and layers["colour0"].inputs == 346


def test_the_schedule_is_the_published_one():
    assert PAPER.architecture == Architecture(voxel=0.005) and PAPER.surface == "body"
    assert (PAPER.schedule.steps, PAPER.schedule.learning_rate, PAPER.schedule.clip) == (400 * 500, 5e-4, 40)
    # A tenth in 1,000 epochs of 500 steps.
    assert (PAPER.schedule.decay, PAPER.schedule.decay_steps) == (0.1, 500_000)
    assert (PAPER.rays.rays, PAPER.rays.samples, PAPER.rays.edge_kernel) == (1024, 64, 5)
    assert PAPER.rays.opacity_weight == PAPER.rays.min_transmittance == 0


def test_the_density_of_paper_is_that_of_ndf_s():
    ndf, ours = preset("paper"), Architecture()
    assert (ours.activation, ours.gain, ours.limit) == (ndf.density_activation, ndf.density_gain,
                                                        ndf.density_limit)
