"""The nominal model from raw recordings: rigid body, rotors, friction, delay, with covariances and what stays unknown."""

from stopset.offline.nominal.nominal import Nominal, identify_nominal, solve_nominal
from stopset.offline.nominal.normal_equations import NormalEquations, accumulate
from stopset.offline.nominal.normal_equations_file import load_sums, sums_bytes
from stopset.offline.nominal.preprocess import Preprocessing
from stopset.offline.nominal.residual import Residual, residuals

__all__ = [
    "Nominal",
    "NormalEquations",
    "Preprocessing",
    "Residual",
    "accumulate",
    "identify_nominal",
    "load_sums",
    "residuals",
    "solve_nominal",
    "sums_bytes",
]
