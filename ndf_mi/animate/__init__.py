"""A trained field in motions that it was not trained on: cameras, frames on disk, video."""
