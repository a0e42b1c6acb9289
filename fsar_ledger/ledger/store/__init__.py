"""The files of a ledger.

```
disk      durable files: all or nothing
paths     where the files are, and what nobody else may write there
record    what ledger.json and commits/*.json hold
walk      what stands at each commit: the walk that everybody folds
append    stage (worker side), Writer (parent side)
prepare   what a Writer does before it appends
read      Head, LedgerView: what is committed
opening   a ledger that is opened for an answer
held      which runs a ledger holds, for its writer
derived   tiles and checkpoint, beside the commits
proof     one event, proven without the ledger
keys      keys as files
problem   one doubt, with its place
```
"""
