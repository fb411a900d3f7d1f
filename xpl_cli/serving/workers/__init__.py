"""Workers, seen from the front end: their processes, what waits for each, and what is told when one fails."""
