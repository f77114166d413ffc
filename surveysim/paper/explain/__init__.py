"""Ingredients beyond one frozen layer, and the findings of the paper that each of them explains."""
