"""Commands that install, serve and play."""
