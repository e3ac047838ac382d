"""A small drone photographer: a procedural town, a flight over it, and the photographs with their
exact cameras and depth."""
