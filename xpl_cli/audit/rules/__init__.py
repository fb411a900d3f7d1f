"""What the rules of `conformance/` are written with: findings, facts, declarations, and the options of an audit."""
