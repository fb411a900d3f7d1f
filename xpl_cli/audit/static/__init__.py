"""What the static gate's rules read: files, syntax trees, shell scripts; nothing is executed."""
