"""Who comes in: connections that may be taken, tokens, and the names by which a server may be asked."""
