"""The served adapter: servers, recorded clients, and comparison of answers."""
