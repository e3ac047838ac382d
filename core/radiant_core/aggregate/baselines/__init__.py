"""Baselines: published ways of joining models, written from their descriptions onto our rasterizer and trainer."""
