"""One module for each maker of checkpoints: how its files are recognised, and what they say."""
