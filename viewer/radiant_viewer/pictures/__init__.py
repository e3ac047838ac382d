"""Layers as finished pictures and films, without a window."""
