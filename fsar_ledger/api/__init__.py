"""The Python API: what the command line does, as functions and a `Ledger`.

`import fsar_ledger` offers it (docs/python.md).
"""
