"""Executors run the nodes of a tree as processes; the nodes' work is defined in `workers`."""
