"""Runs rules: gates in order, checks, cache, waivers, fixes."""
