"""The Kolmogorov-Taylor thin screen: closed forms and realizations."""
