"""The files of a ledger: runs of any length, commits of any size.

```
disk       durable files: all or nothing
growing    files that grow or change in place
paths      where the files are, and where other commands must not write
manifest   the content of ledger.json
problem    one finding and its location
keys       key files
record     the lines of a chain: commits, and placements of their rows; Commits, packed; Head, the end of a ledger
segments   find and read segments
staging    stage: segments that are not committed yet; rows for a journal, and as columns
links      follow a chain line by line
journal    commits whose rows are not in a segment yet
derived    the pack of the tree, and the index: the location of each run, and which segments share runs
snapshot   what is committed at one moment, and how far the file `checkpoint` is behind
read       View: what is committed
locations  where the events of a run are
proof      proof that one event is in a ledger; cose: such a proof as a COSE receipt
prepare    create and lock a ledger; finish what an interrupted writer left
append     Writer
```
"""
