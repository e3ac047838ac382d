"""What the process of a node computes in its folder, and what it tells."""
