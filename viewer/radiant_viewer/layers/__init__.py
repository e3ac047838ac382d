"""Layers, which are plain numbers, and how they are drawn: the same for window, page, pictures and tests."""
