"""The command line: what is typed, and how values are written there."""
