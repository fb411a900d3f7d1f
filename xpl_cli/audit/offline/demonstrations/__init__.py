"""Demonstration check: the actions that a policy predicts in recorded episodes, compared with the demonstrated ones."""
