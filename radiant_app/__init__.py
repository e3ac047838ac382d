"""Wires core and viewer together; only this package handles the command line and executors."""
