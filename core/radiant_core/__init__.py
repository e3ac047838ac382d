"""Computes: reads, reconstructs, plans, trains, merges and measures scenes; draws, distributes and prints nothing."""

import zlib  # noqa: F401, I001  # first of all: pycolmap exports a zlib of its own, and whoever loads it before the system's aborts

__version__ = "0.1.0"
