"""How many cameras each edge and device gets: the fastest deadline, and what slack buys."""
