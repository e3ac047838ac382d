"""Open3D's own window with the model and the same layers, in a process of its own."""
