"""Charts: pictures that are not maps."""
