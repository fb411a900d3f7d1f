"""Parts of `benchmarks/serving.py`: `xpl serve` and `xpl.Client` beside other ways to ask a policy for actions."""
