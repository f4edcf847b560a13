"""The networks of a field in float64, from the same weights; for frequency encodings."""

from __future__ import annotations

import numpy as np

from ndf_mi.field import Field
from ndf_mi.stability.curves import decode, logistic


def gamma(values: np.ndarray, octaves: int) -> np.ndarray:
    """(N, D·(1 + 2·octaves)): values (N, D), then sines and cosines octave by octave."""
    parts = [values]
    for octave in range(octaves):
        parts += [np.sin(values * 2.0**octave), np.cos(values * 2.0**octave)]
    return np.concatenate(parts, 1)


class Network64:
    """A field at one pose, evaluated layer by layer.

    Args:
        field: with the encoding `frequency`.
        weights: the networks', flat.
        pose: (3·J) radians.
    """

    def __init__(self, field: Field, weights: np.ndarray, pose: np.ndarray) -> None:
        self._preset = field.preset
        self._layers = field.layers
        self._weights = weights.astype(np.float64)
        features = pose.astype(np.float64)[None]
        for i in range(len(field.preset.pose_layers)):
            features = self._relu(f"pose{i}", features)
        self._features = features

    def __call__(self, u: np.ndarray, d: np.ndarray, n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """σ (N,) in 1/m and linear colours (N, 3) at u (N, D), seen along d (N, 3), where the body's normals
        are n (N, 3)."""
        p = self._preset
        if p.deformation_layers:
            h = gamma(u, p.deformation_octaves)
            for i in range(len(p.deformation_layers)):
                h = self._relu(f"deform{i}", h)
            u = u + p.deformation_scale * self._linear("deform_out", h)
        encoded = gamma(u, p.octaves)
        h = encoded
        for i in range(len(p.density_layers)):
            if p.density_skip and i == p.density_skip:
                h = np.concatenate([encoded, h], 1)
            h = self._relu(f"density{i}", h)
        out = self._linear("density_out", h)
        if p.feature_width:
            h = out[:, 1:]
        z = out[:, 0] + (p.density_bias if p.density_activation == "softplus" else 0.0)
        a = np.logaddexp(0, z) if p.density_activation == "softplus" else np.maximum(z, 0)
        sigma = -p.density_limit * np.expm1(-a * p.density_gain / p.density_limit)
        for i in range(len(p.colour_linear)):
            h = self._linear(f"linear{i}", h)
        if p.direction_octaves >= 0:
            towards = d - 2 * (d * n).sum(1, keepdims=True) * n if p.direction == "mirrored" else d
            h = np.concatenate([h, gamma(towards, p.direction_octaves)], 1)
        if p.normal_octaves >= 0:
            h = np.concatenate([h, gamma(n, p.normal_octaves)], 1)
        for i in range(len(p.colour_layers)):
            h = self._relu(f"colour{i}", h)
        return sigma, decode(logistic(self._linear("colour_out", h)))

    def _linear(self, name: str, x: np.ndarray) -> np.ndarray:
        layer = self._layers[name]
        columns = layer.inputs + layer.pose
        matrix = self._weights[layer.offset : layer.offset + layer.outputs * columns].reshape(
            layer.outputs, columns)
        bias = self._weights[layer.offset + layer.outputs * columns : layer.offset + layer.affine]
        if layer.pose:
            x = np.concatenate([x, np.broadcast_to(self._features, (len(x), layer.pose))], 1)
        y = x @ matrix.T + bias
        if layer.products:
            mixed = self._weights[layer.offset + layer.affine : layer.offset + layer.size].reshape(
                layer.outputs, layer.inputs, -1)
            y += np.einsum("ni,oik,k->no", x[:, : layer.inputs], mixed, self._features[0])
        return y

    def _relu(self, name: str, x: np.ndarray) -> np.ndarray:
        return np.maximum(self._linear(name, x), 0)


