"""The Python environment of a policy: made from its lock beside the one that is in use, then swapped in one step."""
