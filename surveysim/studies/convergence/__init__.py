"""Accuracy and run time of Monte Carlo and numerical settings, measured along a ladder for each parameter.

Monte Carlo parameters change the error of sigma(A), numerical ones sigma(A) itself. Monte Carlo settings are judged by
their errors. Numerical settings are judged by their bias against the finest setting of the same ladder: the two runs
have the same seed, and common random numbers cancel in the ratio (`surveysim.survey.error_modes.error_modes`). Other
steps of the screen and other sample rates draw different noise: only the weather cancels.
"""

from surveysim.studies.convergence.measure import measure_accuracy
from surveysim.studies.convergence.records import AccuracyResult, Measured, Recommendation, Setting, Slope
from surveysim.studies.convergence.settings import ladders

__all__ = ["AccuracyResult", "Measured", "Recommendation", "Setting", "Slope", "ladders", "measure_accuracy"]
