"""Conversion of demonstration datasets to another format: names, conventions and the conversion job."""
