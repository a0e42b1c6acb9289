"""The files of a ledger.

```
disk      durable files: all or nothing
growing   files that grow, or change at a place
paths     where the files are, and where other commands must not write
record    what ledger.json and commits/*.json hold
walk      what is at each commit: the one walk that everything folds
append    stage (worker side), Writer (parent side)
prepare   what a Writer does before it appends
view      Head, View: what every reader sees
read      LedgerView: what is committed
held      which runs a ledger holds, for its writer
derived   tiles and checkpoint, beside the commits
proof     proof that one event is in a ledger
keys      key files
problem   one finding, with its place
```
"""
