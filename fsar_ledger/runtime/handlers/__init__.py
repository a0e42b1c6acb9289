"""Pure handlers that every architecture shares.

`decide(state, command)` returns events, `react(state, event, time)` commands.
"""
