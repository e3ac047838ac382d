"""The world frame of a reconstruction: up, scale, north, and its uncertainty."""
