"""The sections of a scene file: their keys, units and bounds, as frozen records in internal units."""

from surveysim.sections.air import Atmosphere
from surveysim.sections.analysis import Cleaning, MapSection, Reference, Score, Window
from surveysim.sections.base import Section
from surveysim.sections.instrument import Colour, Instrument, Layout
from surveysim.sections.numerics import Numerics
from surveysim.sections.observing import FieldSection, FixedPointing, Scan, Schedule
from surveysim.sections.streams import Detector, Excess, OpticalLoad, Photon, PointSource, Sky

__all__ = [
    "Atmosphere",
    "Cleaning",
    "Colour",
    "Detector",
    "Excess",
    "FieldSection",
    "FixedPointing",
    "Instrument",
    "Layout",
    "MapSection",
    "Numerics",
    "OpticalLoad",
    "Photon",
    "PointSource",
    "Reference",
    "Scan",
    "Schedule",
    "Score",
    "Section",
    "Sky",
    "Window",
]
