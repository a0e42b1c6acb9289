"""Report templates and the printed numbers of the paper, packaged as `fsar_ledger.reports`."""
