"""Demonstrations: sets of recorded episodes in the field's formats, read lazily, converted, checked and measured."""
