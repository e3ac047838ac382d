"""COLMAP models, binary and text: read into records, checked, written as text."""
