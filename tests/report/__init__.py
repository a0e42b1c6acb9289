"""The report: what it prints, draws, counts and refuses."""
