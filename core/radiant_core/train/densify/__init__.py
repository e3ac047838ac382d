"""Density control: its policies, the edits of Gaussians, and relocation by sampling."""
