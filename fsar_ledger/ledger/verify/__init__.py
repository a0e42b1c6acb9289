"""Verify a ledger by deriving again everything that it says about itself; recover it.

```
verify    the whole ledger
chain     one look at it, segment by segment
segment   one segment: what a worker does
notes     who signed, and whether the ledger only grew
report    what is asked, and what was found
recover   finishes or sets aside what a crash left; deletes nothing
trusted   how much of a ledger can be trusted, mended or copied
```
"""
