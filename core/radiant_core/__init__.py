"""Computes: reads, reconstructs, plans, trains, joins and measures scenes; it draws, distributes
and prints nothing."""

# First of all: pycolmap exports a zlib of its own, and where that is loaded before the system's,
# zlib.compress aborts.
import zlib  # noqa: F401  # pyright: ignore[reportUnusedImport]

__version__ = "0.1.0"
