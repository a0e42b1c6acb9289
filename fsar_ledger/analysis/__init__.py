"""The replay analyzer: any moment of a run, any difference between two, what would have been, and why."""
