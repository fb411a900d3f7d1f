def count():
    """Count."""
