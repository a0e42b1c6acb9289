"""The append-only ledger: it knows bytes and columns, not robots. Four rooms; each imports only those below it.

```
verify    everything derived again and compared; recovery
store     the files: paths, durable writes, appending, reading
rows      the columns, the bytes of a row that are hashed, one segment as Parquet
log       the Merkle tree, notes and signatures: arithmetic, no disk
```
"""
