"""Single changes that may be what is wrong with an adapter: of its native block's words, and around its code."""
