"""The nominal model from raw recordings: rigid body, rotors, friction, delay, with covariances and what stays unknown."""

from stopset.offline.nominal.gram import NormalEquations, accumulate
from stopset.offline.nominal.nominal import Nominal, identify_nominal, solve_nominal
from stopset.offline.nominal.preprocess import Preprocessing
from stopset.offline.nominal.residual import Residual, residuals
from stopset.offline.nominal.sums import load_sums, save_sums

__all__ = [
    "Nominal",
    "NormalEquations",
    "Preprocessing",
    "Residual",
    "accumulate",
    "identify_nominal",
    "load_sums",
    "residuals",
    "save_sums",
    "solve_nominal",
]
