"""Helpers for all other packages: errors, text that is safe to print, files, progress, memory, and worker processes."""
