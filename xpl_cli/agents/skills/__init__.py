"""Agent skills: what they are, where coding agents look for them, and whether they still fit this version."""
