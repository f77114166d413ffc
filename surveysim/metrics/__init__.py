"""Metrics: scores of a co-added map as functions of its noise PSD and transfer function.

A metric is a file with a function ``quantities(noise, options)`` and a row of `registry.METRICS`. The same function
serves simulations, control variates and forecasts; `errors` derives Monte Carlo errors of any of them.
"""
