"""Git repositories, read; nothing is written, and nothing of theirs is run."""
