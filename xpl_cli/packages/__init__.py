"""Policy and environment packages on disk: their manifests, and which of them a request means."""
