"""Typeset the evaluation as a PDF, with its numbers beside the paper's.

`read` and `findings` run the queries, `judge` compares our numbers with the paper's, and `records` adds the results of
studies. `layout` fills the sections of `reports/` for the paper's report, which `build` makes, and for `audit`, the one
of any ledger. `printing`, `figures` and `sequence` format them, `study_charts` draws the results of studies.
"""
