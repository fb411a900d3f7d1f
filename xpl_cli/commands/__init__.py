"""One thin module per command: options, one call into the engine, output."""
