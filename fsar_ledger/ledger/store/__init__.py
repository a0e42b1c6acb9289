"""The files of a ledger.

```
disk      durable files: all or nothing
growing   files that grow, or change at a place
paths     where the files are, and where other commands must not write
manifest  what ledger.json holds
segments  find and read segments
staging   stage: segments that wait for a writer
prepare   create and lock a ledger
view      Head, View: what every reader sees
turns     turns of writers
keys      key files
problem   one finding, with its place
```
"""
