"""Random records of other systems: whatever `append` accepts, every verb answers or refuses, and claims no more."""
