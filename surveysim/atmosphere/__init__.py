"""Kolmogorov-Taylor thin screen: closed forms, realizations, opacity and weather."""
