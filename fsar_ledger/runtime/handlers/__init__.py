"""Pure handlers that every architecture shares: `decide(state, command) -> events`, `react(state, event, time) -> commands`."""
