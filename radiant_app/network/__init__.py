"""Machines of different owners that meet over a network: who they are, what they ask each other."""
