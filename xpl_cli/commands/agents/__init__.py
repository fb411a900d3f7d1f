"""Commands for agents and bots."""
