"""Witnesses of a ledger (C2SP tlog-witness): the service that cosigns, the client that asks, the auditor's policy."""
