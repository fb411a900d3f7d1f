"""The standard: read from `spec/`, shown, checked, frozen, and what documents are held against."""
