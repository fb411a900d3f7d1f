"""A run's record: its lines, which of them count, whose a failure was, and what was run."""
