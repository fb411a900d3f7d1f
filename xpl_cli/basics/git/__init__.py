"""Read-only access to git repositories, without running any of their code. No other module calls git."""
