"""Environments in processes of their own, as whoever drives them sees them."""
