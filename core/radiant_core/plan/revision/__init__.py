"""Plans revised after the fact: for what was captured, for a fleet that has changed."""
