"""From installation to training: interpreters, environments, checkpoints, scripts, containers."""
