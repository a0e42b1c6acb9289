"""The transparency log as pure functions, without disk access.

```
merkle    RFC 6962 hashes and proofs
pack      hashes of the tree in files: which are in the pack or in which tile, and which a commit adds
note      signed notes and checkpoints, and which public keys can be trusted
```
"""
