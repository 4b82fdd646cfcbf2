"""Calls of the public interface that only mypy reads: a changed signature fails `make lint`.

Nothing here runs; the names are public, so a user's type checker sees what this file shows.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from data_prep.events import EventsConfig
from data_prep.log import Audit, AuditEntry, Log
from narxcal import ConfigError, DataError, ModelError, NarxcalError
from narxcal.channels import CHANNELS, Channel, channel
from narxcal.standin import StandInEngine, maker_model
from narxcal.standin_pilot import fly

log: Log = Log("a.csv:left", np.zeros(3), {"N1_pct": np.zeros(3)}, Audit())
length: int = len(log)
interval: float = log.dt_s
speed: NDArray[np.float64] = log["N1_pct"]
matrix: NDArray[np.float64] = log.matrix(["N1_pct"])
audited: Log = log.with_channels({"N2_pct": speed}, AuditEntry("N2_pct", "masked", "frozen", 3))
reasons: dict[str, dict[str, int]] = audited.audit.masked()

lever: Channel = channel("TRA_deg")
known: dict[str, Channel] = CHANNELS

errors: list[type[NarxcalError]] = [DataError, ConfigError, ModelError]
error: NarxcalError = DataError("text", file=Path("a.csv"), channel="N1_pct", row=3, hint="Drop it")

events: EventsConfig = EventsConfig.parse({"driver": "TRA_deg"}, file="demo.toml")

flight: dict[str, NDArray[np.float64]] = fly(0, duration_s=480.0, rate_hz=32.0)
settled: NDArray[np.float64] = maker_model(np.zeros((5, 9)))
outputs: dict[str, NDArray[np.float64]] = StandInEngine().simulate(flight, 1.0 / 32.0)
