"""Benchmarks: run time beside error, as lists of metrics."""
