"""The command line: one typer application (`app.py`) over the answers as text, files and contents of a ledger."""
