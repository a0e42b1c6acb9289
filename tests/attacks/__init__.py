"""Attacks that succeeded on 0.1.0, each against a command in its own process."""
