"""The append-only ledger: knows bytes and columns, not robots.

```
schema     which columns there are, derived from the event types
releases   which columns the rows of earlier releases have
codec      runs of events <-> one Arrow table
canonical  the bytes of one row that are hashed, from structs and again from columns
merkle     RFC 6962 hashes of the rows
segment    one batch of runs as one Parquet file
record     ledger.json and commits/*.json
disk       durable files: all or nothing
place      where a ledger is, and what nobody else may write there
append     stage (worker side), Writer (parent side)
read       Head, LedgerView: what is committed
verify     everything derived again and compared
```
"""
