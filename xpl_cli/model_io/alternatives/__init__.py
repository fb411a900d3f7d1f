"""Single changes that may be what is wrong with an adapter: of its model_io block's words, and around its code."""
