"""Wires core and viewer together; it alone knows the command line, paths and executors."""
