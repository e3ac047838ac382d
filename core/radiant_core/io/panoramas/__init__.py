"""Equirectangular photographs, and the pinhole photographs that are cut from them."""
