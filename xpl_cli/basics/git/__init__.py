"""Git repositories, read; nothing is written, and nothing of theirs is run. No other place of the tool calls git."""
