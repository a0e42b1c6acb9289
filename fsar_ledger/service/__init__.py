"""The service of a live federation: robots, people and programs give it commands over HTTP, and follow its events."""
