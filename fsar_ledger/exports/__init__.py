"""A ledger in the formats of other systems, one file a format: what `export --as` writes."""
