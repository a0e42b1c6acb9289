"""Verify a ledger by deriving again everything that it says about itself; recover it.

```
verify           the whole ledger
walk             the walk of store/walk.py with the rows
segment          one segment: what a worker does
derived          tiles against the rows
notes            who signed, and whether the ledger only grew
recover          finishes or sets aside what a crash left; deletes nothing
trusted_prefix   how much of a ledger can be trusted
rederive         tiles and checkpoint, made again
```
"""
