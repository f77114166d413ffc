"""Report pages: one HTML file with its figures, which asks nothing of the network."""
