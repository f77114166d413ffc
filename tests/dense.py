"""Modules that look at how many detectors have a matrix, for tests of larger arrays."""

from surveysim.forecasting import observing_conditions
from surveysim.reduction import resource_limits, setup
from surveysim.timestreams import shared_parts

DENSE = (observing_conditions, resource_limits, shared_parts, setup)
