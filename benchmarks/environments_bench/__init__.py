"""What `benchmarks/environments.py` measures, here and in the environments of others."""
