"""Layers, which are plain numbers, and how they are drawn: the same in window, page, pictures and tests."""
