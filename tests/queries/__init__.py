"""Given rows, expect rows: every packaged query."""
