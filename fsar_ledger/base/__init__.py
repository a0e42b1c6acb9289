"""What every other room may use: errors, text that is safe to print, files, memory, and worker processes."""
