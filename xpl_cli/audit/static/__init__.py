"""Readers for the rules of `conformance/static`: files, syntax trees, shell scripts; nothing is executed."""
