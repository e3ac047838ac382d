"""Baselines: published ways of joining models, from their descriptions, on our trainer."""
