"""Attacks that succeeded on 0.1.0; `python -m tests.attacks.on_release ff02425` shows that these tests fail there."""
