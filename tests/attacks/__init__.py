"""Attacks that succeeded on 0.1.0, each a test that fails there and passes now; `python -m tests.attacks.on_release ff02425` shows the first half."""
