"""The library of queries, the database, the statistics, the verdicts and untrusted SQL."""
