"""Query a ledger: SQL over its events, the statistics functions that SQL lacks, and typed rows of the answers."""
