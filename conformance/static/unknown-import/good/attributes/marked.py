"""Marked by others."""
