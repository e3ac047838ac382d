"""What a device and an edge of an owner do with a task that came over the network."""
