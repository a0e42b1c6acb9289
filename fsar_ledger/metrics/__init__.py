"""What a ledger says: SQL over its events, the statistics functions it needs, and typed rows of the answers."""
