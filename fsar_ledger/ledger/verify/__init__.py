"""Everything a ledger says about itself, derived again and compared; and its recovery.

```
verify           the whole ledger
commits          its files and its chain of records
segment          one segment: what a worker does
derived          tiles and checkpoint against the rows
notes            who signed, and whether the ledger only grew
recover          finishes or sets aside what a crash left; deletes nothing
trusted_prefix   how much of a ledger can be trusted
rederive         tiles and checkpoint, made again
```
"""
