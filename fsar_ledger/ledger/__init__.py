"""The append-only ledger. It handles bytes and columns, not robots. Each package imports only those below it.

```
verify    re-derive everything and compare; recover
store     the files: paths, durable writes, appending, reading
rows      the columns, the hashed bytes of a row, one segment as Parquet
log       the Merkle tree, signed notes and keys: pure functions, no disk access
```
"""
