"""From a finished model to the next flight: what each cell of its surface is known by, and views."""
