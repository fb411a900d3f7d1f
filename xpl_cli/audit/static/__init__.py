"""Readers for the static gate's rules: files, syntax trees, shell scripts; nothing is executed."""
