"""The world: the only home of randomness. It knows scenarios and robots, but not the architecture."""
