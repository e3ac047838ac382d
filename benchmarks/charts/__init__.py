"""Charts that the benchmarks alone draw."""
