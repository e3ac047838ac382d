"""Speed, accuracy and memory of the rasterizer."""
