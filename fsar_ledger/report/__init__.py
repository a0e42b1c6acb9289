"""Typeset the evaluation as a PDF, with its tables and figures beside the paper's.

`gather` runs the queries, `findings` defines what they yield, `printing` and `figures` render it by the specs of
`reports/`, `document` lays it out, and `build` makes the PDF.
"""
