"""Levels of detail of a model: which Gaussians become one, and in which cells of the land."""
