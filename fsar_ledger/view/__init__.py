"""Runs as pictures to explore: one page of HTML, or a trace for other viewers."""
