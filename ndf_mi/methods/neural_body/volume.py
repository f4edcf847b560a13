"""Neural Body as a volume: codes on vertices, convolutions, features of points, density and colour."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.spatial.transform import Rotation

from ndf_mi.body.box import padded_box
from ndf_mi.capture.capture import Capture
from ndf_mi.field.encoding import frequency
from ndf_mi.field.engines import Batched
from ndf_mi.field.field import BoundField
from ndf_mi.field.layers import initial_weights
from ndf_mi.field.sample import FieldSample, Located
from ndf_mi.methods.neural_body.architecture import Architecture
from ndf_mi.methods.neural_body.encoder import DeviceVoxels, Encoder, padded, place
from ndf_mi.methods.neural_body.interpolation import Lookup, interpolate
from ndf_mi.methods.neural_body.reach import Placed, covered
from ndf_mi.methods.neural_body.voxels import Voxels, voxels
from ndf_mi.methods.volume.volume import Parameters, layer_tensors
from ndf_mi.render.quadrature import Radiance

CACHE_BYTES = 1 << 29
"""Bound on the memory of voxels that are kept for the next time their frame is drawn."""
PROBED = 16
"""At most this many training frames' voxels are counted in advance."""


@dataclass(frozen=True)
class Placement:
    """A pose's voxels and where they are.

    Attributes:
        bbox: of the volume, in world space.
        to_body: from world space to the finest voxels.
        voxels: the voxels.
        shapes: voxels of the box at each stride.
    """

    bbox: mi.BoundingBox3f
    to_body: mi.AffineTransform4f
    voxels: DeviceVoxels
    shapes: tuple[tuple[int, int, int], ...]


class NeuralBodyVolume:
    """Neural Body on the body of a capture.

    Attributes:
        poses: the capture's.
        rates: that of the codes.
    """

    def __init__(self, capture: Capture, architecture: Architecture) -> None:
        self.poses = capture.poses
        self.rates: Mapping[str, float] = {"codes": architecture.code_rate}
        self.architecture = architecture
        self.encoder = Encoder(architecture)
        self.layers = architecture.layers()
        self._training = {frame: row for row, frame in enumerate(capture.splits["train"].frames)}
        self._kept: OrderedDict[int, Placement] = OrderedDict()
        self._rows: tuple[int, ...] | None = None
        self._reach = architecture.reach
        if architecture.cover > 0 and self._training:
            shares = covered(capture, self._placed, architecture.padding)
            enough = [number for number, share in enumerate(shares, start=1) if share >= architecture.cover]
            self._reach = max(self._reach, min(enough, default=len(shares)))

    def initial(self, rng: np.random.Generator) -> dict[str, np.ndarray]:
        """Codes and latent codes are normal with variance 1, weights uniform in ±1/√(fan-in)."""
        vertices = self.poses.vertices.shape[1]
        a = self.architecture
        return {
            "codes": rng.standard_normal(vertices * a.code, dtype=np.float32),
            "convolutions": self.encoder.initial(rng),
            "latents": rng.standard_normal(max(len(self._training), 1) * a.latent, dtype=np.float32),
            "networks": initial_weights(self.layers, rng),
        }

    def at(self, frame: int, parameters: Parameters) -> PosedNeuralBody:
        """The volume at a frame. A frame that was not trained on has the latent code of the last that was."""
        placement = self._placement(frame)
        features = self.encoder(parameters["convolutions"], parameters["codes"], placement.voxels)
        length = self.architecture.latent
        row = dr.opaque(mi.UInt32, self._training.get(frame, max(len(self._training) - 1, 0)))
        latent = dr.gather(mi.Float, parameters["latents"], row * length + dr.arange(mi.UInt32, length))
        tensors = layer_tensors(parameters["networks"], self.layers, {"linear1": latent})
        return PosedNeuralBody(self.architecture, self._reach, placement, features, tensors)

    def _placement(self, frame: int) -> Placement:
        if frame in self._kept:
            self._kept.move_to_end(frame)
            return self._kept[frame]
        if self._rows is None:
            # Padding all frames alike compiles one set of kernels; a tenth more is room for the others.
            frames = list(self._training)[:: -(-len(self._training) // PROBED)] or [frame]
            counts = [[len(stride.sites) for stride in self._voxels(each)[0].strides] for each in frames]
            self._rows = tuple(padded(int(1.1 * most)) for most in np.max(counts, axis=0))
        found, matrix = self._voxels(frame)
        vertices = self.poses.vertices[self.poses.index(frame)]
        lower, upper = padded_box(vertices, self.architecture.padding)
        to_body = mi.AffineTransform4f(matrix)
        dr.make_opaque(to_body)
        placement = Placement(mi.BoundingBox3f(mi.ScalarPoint3f(*lower), mi.ScalarPoint3f(*upper)), to_body,
                              place(found, self._rows), tuple(stride.shape for stride in found.strides))
        self._kept[frame] = placement
        while len(self._kept) > 1 and sum(each.voxels.bytes for each in self._kept.values()) > CACHE_BYTES:
            self._kept.popitem(last=False)
        return placement

    def _placed(self, frame: int) -> Placed:
        found, matrix = self._voxels(frame)
        return found.strides, lambda points: points @ matrix[:3, :3].T + matrix[:3, 3]

    def _voxels(self, frame: int) -> tuple[Voxels, np.ndarray]:
        """The voxels of a frame, and the (4, 4) map from world space to the finest of them."""
        a, row = self.architecture, self.poses.index(frame)
        turn = Rotation.from_rotvec(self.poses.root_rotation[row].astype(np.float64)).as_matrix()
        shift = self.poses.translation[row].astype(np.float64)
        points = (self.poses.vertices[row] - shift) @ turn
        low, high = padded_box(points, a.padding)
        multiple = 2 ** len(a.channels)
        size = (np.ceil((high - low) / a.voxel / multiple).astype(int) * multiple).tolist()
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = turn.T, -turn.T @ shift - low
        matrix[:3] /= a.voxel
        return voxels((points - low) / a.voxel, (size[0], size[1], size[2]), len(a.channels)), matrix


class PosedNeuralBody:
    """Neural Body at one frame; implements `PosedVolume`."""

    sample_factor = 1

    def __init__(self, architecture: Architecture, reach: int, placement: Placement,
                 features: list[mi.Float], tensors: dict[str, tuple[mi.TensorXf, mi.TensorXf]]) -> None:
        self.bbox = placement.bbox
        self._architecture, self._reach, self._to_body = architecture, reach, placement.to_body
        self._features, self._tensors = features, tensors
        dr.eval(features)
        self._lookups = [Lookup(stride.keys, shape) for stride, shape in
                         zip(placement.voxels.strides[1:], placement.shapes[1:], strict=True)]

    def may_contain(self, x: mi.Point3f) -> mi.Bool:
        """Whether voxels of the stride that the volume reaches to are around."""
        if not self._reach:
            return mi.Bool(True)
        return self._lookups[self._reach - 1].any_around(self._place(x, self._reach))

    def locate(self, x: mi.Point3f, active: mi.Bool) -> Located:
        """Nothing but where the volume is not empty."""
        return Located.anywhere(active & self.may_contain(x))

    def density(self, x: mi.Point3f, located: Located, active: mi.Bool) -> mi.Float:
        """σ in 1/m; detached."""
        with dr.suspend_grad():
            engine = Batched(self._tensors, dr.width(active))
            sigma = dr.select(active, self._density(engine, self._hidden(engine, x, active)), 0)
            dr.eval(sigma)
        return sigma

    def evaluate(self, x: mi.Point3f, d: mi.Vector3f, located: Located, active: mi.Bool) -> FieldSample:
        """Density and linear colour."""
        a, engine = self._architecture, Batched(self._tensors, dr.width(active))
        x, d = dr.select(active, dr.detach(x), 0), dr.select(active, dr.detach(d), 0)
        h = self._hidden(engine, x, active)
        sigma = self._density(engine, h)
        h = engine.linear("linear1", engine.enter(engine.linear("linear0", h)))
        encoded = []
        for values, octaves in ((d, a.direction_octaves), (x, a.position_octaves)):
            if octaves >= 0:
                encoded += frequency(list(values), octaves)
        h = dr.maximum(engine.linear("colour0", engine.enter(h, encoded)), 0)
        colour = BoundField.colour(mi.Color3f(*engine.rows(engine.linear("colour_out", engine.enter(h)))))
        nowhere = dr.zeros(mi.Point3f, dr.width(active))
        return FieldSample(sigma, colour, nowhere, mi.Normal3f(nowhere))

    def penalty(self, radiance: Radiance) -> mi.Float | None:
        """None: the published loss is the image's alone."""
        return None

    def _place(self, x: mi.Point3f, stride: int) -> mi.Point3f:
        """Points in voxels of a stride, whose index is given: their voxels lie at multiples of 2^stride."""
        return (self._to_body @ x) * 0.5**stride

    def _hidden(self, engine: Batched, x: mi.Point3f, active: mi.Bool) -> mi.TensorXf:
        """The density network's last hidden layer."""
        features = []
        for number, (lookup, values) in enumerate(zip(self._lookups, self._features, strict=True), start=1):
            corners = lookup.corners(self._place(x, number), active)
            features.append(interpolate(values, self._architecture.channels[number], corners))
        h = engine.enter(*features)
        for number in range(len(self._architecture.density_layers)):
            h = engine.enter(dr.maximum(engine.linear(f"density{number}", h), 0))
        return h

    def _density(self, engine: Batched, h: mi.TensorXf) -> mi.Float:
        return self._architecture.density(engine.rows(engine.linear("density_out", h))[0])
