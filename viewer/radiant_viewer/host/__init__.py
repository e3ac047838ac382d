"""What docks and tools see of the window: the `Host` protocol, its two views and a picture label. Needs the `desktop` extra."""
