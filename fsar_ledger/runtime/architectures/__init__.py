"""Architectures are structure only: deterministic tables of pure handlers, without access to randomness.

Each is a folder here, with a `HandlerTable` under its name in capitals, and one line in
`events.configuration.ARCHITECTURES`.
What can be taken out of it is listed under its name in `events.configuration.MECHANISMS_OF`, if anything can.
"""

# See docs/decisions/architectures-have-folders.md.
