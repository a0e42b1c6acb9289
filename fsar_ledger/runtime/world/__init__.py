"""The world: the only home of randomness. It knows scenarios and robots, and never the architecture."""
