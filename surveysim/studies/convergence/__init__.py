"""Accuracy and time of a survey's Monte Carlo and numerical settings, measured along a ladder for each parameter.

Monte Carlo parameters change how well sigma(A) is known, numerical ones sigma(A) itself. The first are judged by their
errors, the second by their bias against the finest setting of their own ladder, all else being equal: the two runs
have one seed, and what is common to their random numbers cancels in the ratio (`surveysim.survey.scores.error_modes`).
Other steps of the screen and other sample rates draw other noise, of which nothing cancels but the weather.
"""

from surveysim.studies.convergence.measure import measure_accuracy
from surveysim.studies.convergence.records import AccuracyResult, Measured, Recommendation, Setting, Slope
from surveysim.studies.convergence.settings import ladders

__all__ = ["AccuracyResult", "Measured", "Recommendation", "Setting", "Slope", "ladders", "measure_accuracy"]
