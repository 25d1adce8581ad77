"""The model file: the one thing that leaves the identification and enters monitor and FMU."""

from stopset.artifact.abstraction import Abstraction
from stopset.artifact.model import (
    SCHEMA_VERSION,
    ActiveBound,
    Brakes,
    Domain,
    Guarantee,
    Model,
    Revision,
    TemperatureBand,
    TorqueZonotope,
    UncertaintySets,
)
from stopset.artifact.store import load_model, model_text, save_model

__all__ = [
    "SCHEMA_VERSION",
    "Abstraction",
    "ActiveBound",
    "Brakes",
    "Domain",
    "Guarantee",
    "Model",
    "Revision",
    "TemperatureBand",
    "TorqueZonotope",
    "UncertaintySets",
    "load_model",
    "model_text",
    "save_model",
]
