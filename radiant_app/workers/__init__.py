"""What the process of a node reads, computes and writes in its folder."""
