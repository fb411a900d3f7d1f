"""The search for the mistake of an adapter: its answers under each, by a ruler that says how far they are off."""
