"""Runs: plan, schedule, stopping rule, execution and progress."""
