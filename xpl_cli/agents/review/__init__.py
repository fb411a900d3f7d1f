"""Review of a branch: its effect on the packages of a repository, worst findings first."""
