"""Commands that report results of runs."""
