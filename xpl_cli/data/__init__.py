"""Demonstration datasets: recorded episodes in several formats, read lazily, converted, validated and probed."""
