"""Animatable NeRF (Peng et al. 2021, *Animatable Neural Radiance Fields for Modeling Dynamic Human
Bodies*)."""
