"""SQL queries, packaged as `fsar_ledger.queries`: one concept a file, named after what it yields."""
