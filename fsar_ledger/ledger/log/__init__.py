"""The transparency log as arithmetic, without a disk.

```
merkle    RFC 6962 hashes and proofs
tiles     which hashes are in which tile, and what a commit adds
note      signed notes and checkpoints
ed25519   which public keys are worth anything
```
"""
