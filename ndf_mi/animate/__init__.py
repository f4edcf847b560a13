"""Renders a trained field in new motions: cameras, frames on disk, video."""
