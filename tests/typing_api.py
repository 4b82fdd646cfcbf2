"""Calls of the public interface that only mypy reads: a changed signature fails `make lint`.

Nothing here runs; the names are public, so a user's type checker sees what this file shows.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

import narxcal as nx
from data_prep import Audit, AuditEntry, Event, EventsConfig, Log, find_events, read_logs
from data_prep.cleaning.clean import CleanConfig, clean
from data_prep.cleaning.smooth import SmoothConfig, smooth
from data_prep.prepare import Prepared, prepare
from eval.results import Judgement, PreparedLogs, Recordings, Training
from narxcal import (
    Bundle,
    Calibration,
    ConfigError,
    DataError,
    DynamicCalibration,
    KalmanFuser,
    ModelError,
    Narx,
    NarxcalError,
    Record,
    load_bundle,
    save_bundle,
)
from narxcal.calibration.fuser import FusedRun, FusedStep
from narxcal.calibration.noise import NoiseModel
from narxcal.channels import CHANNELS, Channel, channel
from narxcal.flight_test.fly import VirtualLog, fly, load_scenario, write_flights
from narxcal.flight_test.scenario import FlightScenario
from narxcal.turbofan import VirtualEngine, maker_model
from training.config import RunConfig, load_config
from training.responses import transients
from training.responses.transients import Assessment, Overlay, TransientsConfig

Floats = NDArray[np.float64]

log: Log = Log("a.csv:left", np.zeros(3), {"N1_pct": np.zeros(3)}, Audit())
length: int = len(log)
interval: float = log.dt_s
speed: Floats = log["N1_pct"]
matrix: Floats = log.matrix(["N1_pct"])
audited: Log = log.with_channels({"N2_pct": speed}, AuditEntry("N2_pct", "masked", "frozen", 3))
reasons: dict[str, dict[str, int]] = audited.audit.masked()

lever: Channel = channel("TRA_deg")
known: dict[str, Channel] = CHANNELS

errors: list[type[NarxcalError]] = [DataError, ConfigError, ModelError]
error: NarxcalError = DataError("text", file=Path("a.csv"), channel="N1_pct", row=3, hint="Drop it")

events: EventsConfig = EventsConfig.parse({"driver": "TRA_deg"}, file="demo.toml")

scenario: FlightScenario = load_scenario("demo")
flight: list[VirtualLog] = fly(scenario, 1)
settled: Floats = maker_model(np.zeros((5, 9)))
outputs: dict[str, Floats] = VirtualEngine().simulate(flight[0].recorded, 1.0 / 32.0)
truth: dict[str, Any] = write_flights(Path("flights"), scenario)

config: RunConfig
folder: Path
config, folder = load_config("demo.toml")
raw: list[Log] = read_logs(config.logs.resolve(folder), config.logs)
prepared: list[Prepared] = prepare(raw, config)
smoothed: Log = smooth(clean(raw[0], CleanConfig()), SmoothConfig(window=11))
found: list[Event] = find_events(smoothed, config.events)

bundle: Bundle = load_bundle("run")
save_bundle("copy", bundle)
model: Calibration = bundle.calibration
kind: type[Calibration] = DynamicCalibration
inputs: Floats = smoothed.matrix(model.input_names)
measured: Floats = smoothed.matrix(model.output_names)
free_run: Floats = model.simulate(inputs, start=measured[0])
one_step: Floats = model.predict(inputs, measured)
first: Floats = model.reset(inputs[0])
following: Floats = model.step(inputs[1], correction=measured[0])
network: Narx = Narx().fit(
    [(inputs, measured), Record(inputs, measured)], validation=[(inputs, measured)]
)
fit: float = network.score([(inputs, measured)])


def fuse(noise: NoiseModel) -> FusedRun:
    """Merge prediction and measurement, one sample or a whole record at a time."""
    fuser = KalmanFuser(noise)
    started: FusedStep = fuser.reset(free_run[0], measured[0])
    value: Floats = started.value
    return fuser.run(free_run, value + measured)


recordings: Recordings = nx.read("flights/*.csv", config)
examined: PreparedLogs = nx.prepare(recordings)
training: Training = nx.train(recordings, out=Path("run"))
judgement: Judgement = nx.evaluate(training, ["flight.csv"], trim=0.2)
tables: list[pd.DataFrame] = [examined.events, training.scores, judgement.events, judgement.faults]
axes: Axes = nx.plot.compare(judgement["flight_3*"], channel="N1_pct")
axes = nx.plot.resid((inputs, measured), network, cross=True, ax=axes)
axes = nx.plot.steps(training, smoothed, driver="TRA_deg")
axes = nx.plot.frequency(smoothed, model)
axes = nx.plot.events(examined)
axes = nx.plot.compare((inputs, measured), free_run)
axes = network.plot((inputs, measured))
axes = nx.plot.gap(nx.diagnose("flights", "run"))
drawing: Figure = judgement.plot(log=1)

overlay: Overlay = Overlay(smoothed.time_s, measured, free_run, model.output_names)
judged: list[Assessment] = transients.assess_events(found, overlay, TransientsConfig(rules="paper"))
