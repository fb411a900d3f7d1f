"""Agent skills: format, installation for coding agents, and checks of installed copies."""
