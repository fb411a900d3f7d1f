"""The oracle: what a policy would have done in recorded demonstrations, beside what was done in them."""
