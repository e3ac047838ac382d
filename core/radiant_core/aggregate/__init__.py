"""Joining models: synthetic views, retraining, cropping at borders."""
