"""What `benchmarks/authors_loops.py` runs and compares."""
