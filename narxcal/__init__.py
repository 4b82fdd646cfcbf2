"""Calibrates the dynamics of a steady-state turbofan model from flight-test logs.

Public names are imported on first use, so that `data_prep`, which needs only channels and errors,
does not import the models, and nothing imports PyTorch before it trains.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from eval.diagnosis.diagnose import diagnose
    from eval.report import plot
    from eval.results import evaluate, prepare, read, train
    from narxcal.calibration.bundle import Bundle, load_bundle, save_bundle
    from narxcal.calibration.calibration import Calibration
    from narxcal.calibration.dynamic import DynamicCalibration
    from narxcal.calibration.fuser import KalmanFuser
    from narxcal.calibration.noise import NoiseModel
    from narxcal.narx.config import NarxConfig
    from narxcal.record import Record
    from narxcal.support.errors import ConfigError, DataError, ModelError, NarxcalError
    from training.estimator.narx import Narx

__all__ = [
    "Bundle",
    "Calibration",
    "ConfigError",
    "DataError",
    "DynamicCalibration",
    "KalmanFuser",
    "ModelError",
    "Narx",
    "NarxConfig",
    "NarxcalError",
    "NoiseModel",
    "Record",
    "diagnose",
    "evaluate",
    "load_bundle",
    "plot",
    "prepare",
    "read",
    "save_bundle",
    "train",
]

_MODULE_OF = {
    "Bundle": "narxcal.calibration.bundle",
    "Calibration": "narxcal.calibration.calibration",
    "ConfigError": "narxcal.support.errors",
    "DataError": "narxcal.support.errors",
    "DynamicCalibration": "narxcal.calibration.dynamic",
    "KalmanFuser": "narxcal.calibration.fuser",
    "ModelError": "narxcal.support.errors",
    "Narx": "training.estimator.narx",
    "NarxConfig": "narxcal.narx.config",
    "NarxcalError": "narxcal.support.errors",
    "NoiseModel": "narxcal.calibration.noise",
    "Record": "narxcal.record",
    "diagnose": "eval.diagnosis.diagnose",
    "evaluate": "eval.results",
    "load_bundle": "narxcal.calibration.bundle",
    "prepare": "eval.results",
    "read": "eval.results",
    "save_bundle": "narxcal.calibration.bundle",
    "train": "eval.results",
}


def __getattr__(name: str) -> object:
    """Import a public name when it is first used (PEP 562)."""
    if name == "plot":
        value: object = import_module("eval.report.plot")
    elif name in _MODULE_OF:
        value = getattr(import_module(_MODULE_OF[name]), name)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
