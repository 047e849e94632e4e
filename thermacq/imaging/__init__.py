"""What the cameras' pictures are worth: corrections applied on reading, noise, preheating.

Raw counts are never altered.
"""

from thermacq.imaging.corrections import (
    NO_CORRECTIONS,
    CorrectedPictures,
    Corrections,
    Stage,
    check_fits,
    corrections_of,
    doubts,
)

__all__ = [
    "NO_CORRECTIONS",
    "CorrectedPictures",
    "Corrections",
    "Stage",
    "check_fits",
    "corrections_of",
    "doubts",
]
