"""New packages from templates, and old ones brought to a newer version with their author's work kept."""
