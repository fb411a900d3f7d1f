"""Commands that record, read, check, convert and show demonstrations."""
