"""Text tables for a terminal of any width."""
