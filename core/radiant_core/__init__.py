"""Computes: reads, reconstructs, plans, trains, joins and measures scenes; it draws, distributes
and prints nothing."""

# First of all: pycolmap exports a zlib of its own, which Python's module must not be bound to.
import zlib  # noqa: F401  # pyright: ignore[reportUnusedImport]

__version__ = "0.1.0"
