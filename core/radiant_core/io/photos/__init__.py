"""Photographs and their masks: listed, checked, decoded."""
