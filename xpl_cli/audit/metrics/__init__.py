"""What the standard claims of adapters, measured and drawn."""
