"""The policy server: a front end that speaks the wire, and a worker that runs the adapter in its own interpreter."""
