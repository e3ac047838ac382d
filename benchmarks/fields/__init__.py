"""Radiance fields: what other rooms split and join to compare with Gaussians."""
