"""Wires core and viewer together; the only package that knows the command line, paths and executors."""
