"""Turns commands into events: the world's draws, pure handlers, architectures, and the clock that runs them."""
