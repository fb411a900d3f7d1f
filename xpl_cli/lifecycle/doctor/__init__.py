"""What a machine can run, by testing it; risky tests run in a process of their own."""
