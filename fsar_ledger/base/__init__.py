"""What every other room may use: errors, text that is safe to print, files, progress, memory, and worker processes."""
