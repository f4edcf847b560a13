"""Neural Body (Peng et al. 2021): codes on the body's vertices, diffused by sparse convolutions."""
