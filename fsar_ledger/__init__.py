"""An event-sourced audit ledger and replay analyzer for robot fleets, after the FSAR paper."""

__version__ = "0.4.0"
