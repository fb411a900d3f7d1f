"""Environment packages, as an audit runs them."""
