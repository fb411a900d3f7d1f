"""What the records of runs show, how sure that is, and what they do not show."""
