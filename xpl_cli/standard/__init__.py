"""The standard: read from `spec/`, shown, checked, and what documents are held against."""
