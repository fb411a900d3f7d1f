"""Many runs side by side: a ranking that says how sure it is, and the result files of two benchmarks in the field."""
