"""The append-only ledger. It knows bytes and columns, not robots. Each package imports only those below it.

```
verify    derive everything again and compare; recover
store     the files: paths, durable writes, appending, reading
rows      the columns, the bytes of a row that are hashed, one segment as Parquet
log       the Merkle tree, signed notes and keys: pure functions, no disk access
```
"""
