"""Photographs into models: a batch of runs, the demo, structure from motion, one model alone."""
