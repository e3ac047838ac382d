"""From a finished model to the next flight: what is known of its surface, and views to add."""
