"""Geometry of trained models: moving them, comparing surfaces, aligning their frames."""
