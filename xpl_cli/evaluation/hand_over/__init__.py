"""A benchmark's own launcher, described by env.yml: called with the standard's arguments, its result read back."""
