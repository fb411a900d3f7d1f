"""Child processes: how one is started, its private link to the parent, and how it ends with its parent."""
