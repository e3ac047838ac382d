"""Pictures that are no maps."""
