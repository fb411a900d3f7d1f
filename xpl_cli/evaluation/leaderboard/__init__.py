"""Rankings of runs with their uncertainty, and the result files of two other benchmarks."""
