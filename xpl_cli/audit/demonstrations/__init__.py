"""Checks of demonstrations, with the audit's findings: what is wrong with a set, whatever its format."""
