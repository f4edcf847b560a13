"""What volume methods other than NDF share: training on rays, images in chunks, and a saved folder."""
