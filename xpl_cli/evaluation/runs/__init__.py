"""A run: what it plays, in which order, until when, and how far it has come."""
