"""Architectures are structure only: deterministic wirings of pure handlers, without access to randomness."""
