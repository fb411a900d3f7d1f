"""Python environments of policies: created from a lockfile, and switched atomically."""
