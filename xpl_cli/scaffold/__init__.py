"""New packages from templates, and older ones brought to today's templates with their author's work kept."""
