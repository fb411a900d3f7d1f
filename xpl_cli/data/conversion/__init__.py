"""Sets of demonstrations turned into another format: names, conventions by a mapping, and the work itself."""
