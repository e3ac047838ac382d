"""Alignments of other programs, one reader per format, all ending in the same `PoseFile`."""
