"""Where a package stands and what comes next, from its files and from what audits found; nothing of it is run."""
