"""Geometry of trained models: moving them, comparing their surfaces, bringing their frames together."""
