"""The transparency log as pure functions, without disk access.

```
merkle    RFC 6962 hashes and proofs
tiles     which hashes are in which tile, and which tiles a commit adds
note      signed notes and checkpoints, and which public keys can be trusted
```
"""
