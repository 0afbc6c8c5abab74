"""Typed settings of the steps.

Every model is the settings argument of the function that uses it and, field by field, the options
of its command; most are sections of ``config/config.yaml`` as well. So a key has one name, one
check and one description everywhere.
"""

from eofm.settings.estimation import ALPHA, PAPER, WARPING, Estimation, Identification, Tracking
from eofm.settings.pairs import (
    EDGE_WORDS,
    Figures,
    Measures,
    Pair,
    PartOfScale,
    Region,
    Scale,
    Tiling,
)
from eofm.settings.samples import Forward, Inclusion, Phantom, Sample, VirtualOct
from eofm.settings.section import FAR, LARGEST, LEAST, LONG, Positive, Section, Spread

__all__ = [
    "ALPHA",
    "EDGE_WORDS",
    "FAR",
    "LARGEST",
    "LEAST",
    "LONG",
    "PAPER",
    "WARPING",
    "Estimation",
    "Figures",
    "Forward",
    "Identification",
    "Inclusion",
    "Measures",
    "Pair",
    "PartOfScale",
    "Phantom",
    "Positive",
    "Region",
    "Sample",
    "Scale",
    "Section",
    "Spread",
    "Tiling",
    "Tracking",
    "VirtualOct",
]
