"""What is measured on a run, and what changed between two of them."""
