"""One module for each framework that writes checkpoints: recognition and reading of its files."""
