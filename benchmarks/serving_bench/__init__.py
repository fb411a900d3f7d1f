"""Parts of `benchmarks/serving.py`: `xpl serve` and `xpl.Client` beside other ways to get actions of a policy."""
