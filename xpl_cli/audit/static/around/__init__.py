"""What lies around the boundary of an adapter: trees that were vendored, and the checkout that holds it."""
