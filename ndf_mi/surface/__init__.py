"""The body's surface fitted to images: a texture, vertex offsets, or both. `fit_texture`, `fit_offsets` and,
from masks alone, `fit_reference` are the doors.
"""
