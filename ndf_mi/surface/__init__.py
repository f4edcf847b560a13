"""The body's surface fitted to images: a texture, vertex offsets, or both. `fit_texture` and `fit_offsets`
are the doors.
"""
