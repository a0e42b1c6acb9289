"""Witnesses of a ledger, as C2SP tlog-witness says: who cosigns its checkpoints, who asks for that, and whom an auditor believes."""
