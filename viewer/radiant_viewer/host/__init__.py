"""What docks and tools see of the window: protocols and its two views. Needs `desktop` extra."""
