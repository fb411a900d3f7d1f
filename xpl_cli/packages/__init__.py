"""Policy and environment packages: their manifests, configurations and lookup by name."""
