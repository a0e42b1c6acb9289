"""Rows: events as typed columns, the bytes that are hashed, and the one accepted form of a segment on disk.

```
schema      the columns, derived from the event types, and those that each release wrote
runs        what a run handed to a writer may hold; its pieces, put together
codec       runs of events <-> one Arrow table
compiled    the hot paths of the codec in C, where they were built: events -> rows, rows -> columns
canonical   the hashed bytes of a row, made from structs and again from columns
check       the rules for every stored row
blocks      which rows of which run a table holds
segment     one batch of runs as one Parquet file
layout      whether a segment has the accepted form; grammar: which bytes may be there
bounds      what a segment may cost to read
arrow       helpers for reading and making columns
```
"""
