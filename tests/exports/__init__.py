"""Each format is read by a reader that others wrote."""
