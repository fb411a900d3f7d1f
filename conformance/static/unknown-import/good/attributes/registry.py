"""Filled by others."""
