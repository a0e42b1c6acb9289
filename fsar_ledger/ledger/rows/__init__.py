"""Rows: events as typed columns, the bytes that are hashed, and the one form of a segment on the disk.

```
schema      which columns there are, derived from the event types
releases    which columns the rows of earlier releases have
runs        what a run handed to a writer may hold
codec       runs of events <-> one Arrow table
canonical   the bytes of one row that are hashed, from structs and again from columns
check       what every stored row must be
segment     one batch of runs as one Parquet file
layout      whether a segment lies as every reader reads it, by grammar (the bytes allowed) and footer (why not)
bounds      what a segment may cost to read
arrow       columns in one piece, as codes and numbers
```
"""
