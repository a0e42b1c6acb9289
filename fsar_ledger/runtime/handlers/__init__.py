"""Pure handlers that every architecture shares:

`decide(state, command)` to events, `react(state, event, time)` to commands.
"""
