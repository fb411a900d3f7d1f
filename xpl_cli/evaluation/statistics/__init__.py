"""Statistics of recorded runs: rates, intervals, tests, and what they do not show."""
