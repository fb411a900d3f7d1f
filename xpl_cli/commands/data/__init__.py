"""Commands that list, validate, probe, convert and show demonstrations."""
