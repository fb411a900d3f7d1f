"""What native.py takes from the adapter that it is held against, and where that stands."""
