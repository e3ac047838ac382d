"""Layers as plain numbers, and how they are drawn: the same in window, page and pictures."""
