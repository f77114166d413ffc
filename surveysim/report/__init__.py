"""Results for people: figures, tables on a terminal, and HTML pages."""
