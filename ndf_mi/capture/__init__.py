"""Multi-view captures: the format on disk, its reader, writer and checker, and the synthetic performer."""
