"""Draws the core types: one set of layers for window, web page, report and offscreen tests."""
