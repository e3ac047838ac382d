"""Geometry on points and meshes through Open3D."""
