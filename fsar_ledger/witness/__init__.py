"""Witnesses of a ledger (C2SP tlog-witness): the service that cosigns, the client, and the auditor's policy."""
