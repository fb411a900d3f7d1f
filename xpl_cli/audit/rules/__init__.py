"""What a rule is written with: findings, facts, its declaration, and what an audit is asked to do."""
