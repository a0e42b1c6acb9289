"""Projections: state rebuilt from events. One file per concept, each with `INITIAL`, `evolve` and `HANDLES`."""
