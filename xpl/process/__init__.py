"""Processes of our own: how one is started, what it is told over its private link, and how it ends with its parent."""
