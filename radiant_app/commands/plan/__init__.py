"""Regions before capture, and plans that are made again for the devices that are left."""
