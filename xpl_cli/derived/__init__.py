"""What is written from the standard, the rules and the command line: constants of the SDK, and pages."""
