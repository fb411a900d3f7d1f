class Layer:
    """One."""
