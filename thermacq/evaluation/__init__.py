"""Judging results: wave statistics, agreement of stereo and probe, flatness, quantisation error.

Arrays in, frozen records out.
"""

from thermacq.evaluation.comparison import Agreement, Comparison, agreement, compare_series
from thermacq.evaluation.flatness import Flatness, flatness
from thermacq.evaluation.lag import Lag, estimate_lag
from thermacq.evaluation.quantisation import QuantisationCurve, quantisation_curve
from thermacq.evaluation.series import PreparedSeries, WaveError, prepare
from thermacq.evaluation.waves import Waves, WaveStatistics, single_waves, wave_statistics

__all__ = [
    "Agreement",
    "Comparison",
    "Flatness",
    "Lag",
    "PreparedSeries",
    "QuantisationCurve",
    "WaveError",
    "WaveStatistics",
    "Waves",
    "agreement",
    "compare_series",
    "estimate_lag",
    "flatness",
    "prepare",
    "quantisation_curve",
    "single_waves",
    "wave_statistics",
]
