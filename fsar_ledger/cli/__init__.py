"""The command line: a typer application (`app.py`) with a file for each command, and answers as text."""
