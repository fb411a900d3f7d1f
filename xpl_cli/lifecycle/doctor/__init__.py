"""What a machine can run: every answer comes from trying it, in a process of its own where that could do harm."""
