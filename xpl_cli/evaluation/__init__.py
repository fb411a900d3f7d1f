"""Rollouts of policies in environments: run, recorded, summarised, compared and reported."""
