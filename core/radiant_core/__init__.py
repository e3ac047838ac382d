"""Computes: reads, reconstructs, plans, trains, joins and measures scenes; it draws nothing."""

# First of all: zlib.compress aborts where pycolmap's own zlib is loaded before the system's.
import zlib  # noqa: F401  # pyright: ignore[reportUnusedImport]

__version__ = "0.1.0"
