"""Typeset the evaluation as a PDF, with its numbers beside the paper's.

`read` and `findings` ask the queries, `judge` lays our numbers beside the paper's, and `records` adds what studies
left. `layout` fills the sections of `reports/` for the paper's report, which `build` makes, and for `audit`, the one of
any ledger. `printing`, `figures` and `sequence` give them their shapes, `study_charts` draws the results of studies.
"""
