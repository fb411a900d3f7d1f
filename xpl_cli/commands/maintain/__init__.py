"""Commands for who keeps the standard."""
