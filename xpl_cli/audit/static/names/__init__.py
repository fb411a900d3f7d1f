"""Names that modules offer and import, read from their syntax trees."""
