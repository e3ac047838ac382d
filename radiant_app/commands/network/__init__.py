"""This machine as one of several that meet over a network or by a disk."""
