"""The transparency log as pure functions, without disk access.

```
merkle    RFC 6962 hashes and proofs
pack      tree hashes in files: their positions in the pack or in tiles, and which ones a commit adds
note      signed notes and checkpoints, and which public keys can be trusted
```
"""
