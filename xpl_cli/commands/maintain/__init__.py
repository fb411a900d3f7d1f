"""Commands for maintainers of the standard."""
