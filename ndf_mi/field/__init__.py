"""The neural field: encodings, networks, presets. Pure functions of numbers, without scenes, files or
meshes."""

from ndf_mi.field.field import BoundField, Field
from ndf_mi.field.layers import FieldParameters
from ndf_mi.field.presets import PRESETS, Preset, preset

__all__ = ["PRESETS", "BoundField", "Field", "FieldParameters", "Preset", "preset"]
