"""Reading of checkpoints and their datasets: the facts that they state about the model, with their sources."""
