"""Commands that write packages."""
