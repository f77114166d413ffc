"""Output directories: their lock, names and record of files, and the writers of results."""
