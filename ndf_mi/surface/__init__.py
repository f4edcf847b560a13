"""The body as a mesh that emits a texture, and its fits to images: texture, vertex offsets, contours."""
