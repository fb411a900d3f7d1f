"""The report of a recorded run: one page that needs no network, and the same as Markdown, CSV and JSON."""
