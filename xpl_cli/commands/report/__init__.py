"""Commands that tell what runs showed."""
