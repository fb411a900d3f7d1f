"""Reviews of changes: what a branch does to the packages of a repository, in the order in which it matters."""
