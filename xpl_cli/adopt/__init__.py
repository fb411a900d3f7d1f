"""Adoption: the manifest of an adapter that has none, read from its files; none of its code is run."""
