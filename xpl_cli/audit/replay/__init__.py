"""What an audit asked and heard, played against another server."""
