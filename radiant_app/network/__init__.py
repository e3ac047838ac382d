"""Machines of different owners that meet over a network: what cloud, edges and devices do with a
run, and what carries that between them."""
