"""Benchmarks: run time beside error, as lists of metrics. They are run in the source and not installed."""
