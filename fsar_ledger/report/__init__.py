"""Typeset the evaluation as a PDF, with its numbers beside the paper's.

`read` and `experiments` ask the queries, `judge` lays our numbers beside the paper's, and `records` adds what studies
left. `layout` fills the sections of `reports/` for `document`, the paper's report, and `audit`, the one of any ledger.
`printing`, `charts` and `sequence` give them their shapes, and `build` makes the PDF.
"""
