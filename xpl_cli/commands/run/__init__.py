"""Commands that install, serve and run rollouts."""
