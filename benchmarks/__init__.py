"""Benchmarks: run time beside error, as lists of metrics. Run in the source, not installed."""
