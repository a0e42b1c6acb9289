"""The files of a ledger.

```
disk      durable files: all or nothing
paths     where a ledger is, and what nobody else may write there
record    ledger.json and commits/*.json
append    stage (worker side), Writer (parent side)
read      Head, LedgerView: what is committed
opening   a ledger that is opened for an answer
held      which runs a ledger holds, for its writer
derived   tiles and checkpoint, beside the commits
proof     one event, proven without the ledger
keys      keys as files
problem   one doubt, with its place
```
"""
