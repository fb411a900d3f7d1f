"""An adapter that is really served: servers, clients, and what they said to each other."""
