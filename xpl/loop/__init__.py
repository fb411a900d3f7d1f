"""An adapter's evaluation loop in a process of its own: what it is given there in place of environment and client."""
