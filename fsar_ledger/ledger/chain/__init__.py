"""A ledger: runs of any length, commits of any size.

```
record     the lines of a chain: commits, and placements of their rows
torn       what is torn, and what is damaged
links      follow a chain line by line
journal    commits whose rows are not in a segment yet
tables     rows of a journal as columns
derived    the pack of the tree, and the index, on disk
index      which runs are where
indexed    whether it says what the rows say
groups     which segments share runs
paths      where the files are
read       View: what is committed
checkpoint the file `checkpoint`, which may be behind
prepare    what a writer does before it appends
held       which runs a ledger holds, and how far
compact    which segments are put together
places     where the events of a run are
proof      proof that one event is in a ledger
append     Writer
```
"""
