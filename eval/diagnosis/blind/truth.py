"""The two engines of a case: the simulator's, and the real one with what nobody modelled."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from eval.diagnosis.blind.cases import Base, BlindPlan, Case, Dose, Windows, drawn
from eval.diagnosis.blind.lumped import KINDS, LumpedEngine
from eval.diagnosis.blind.outside import MISFIT, applied
from narxcal.flight_test.plan import FlightPlan, plan_flight
from narxcal.flight_test.scenario import drawn_windows
from narxcal.flight_test.sensors import ChannelSensor, SensorConfig, Streams, record
from narxcal.support.arrays import FloatArray
from narxcal.turbofan import Unmodelled, VirtualEngine, build_scatter
from narxcal.turbofan.cycle import Health

Channels = dict[str, FloatArray]
Engine = VirtualEngine | LumpedEngine
OUTPUTS: Final = ("N1_pct", "N2_pct", "EGT_C", "FF_kgph")
# The lags of the instrumentation itself are known and in the simulator: they are no gap.
LAGS_S: Final = {name: SensorConfig().sensor(name).tau_s for name in OUTPUTS}
# What a simulator's maker adds to its outputs for a recording: white noise and steps.
_WHITE: Final = {
    "N1_pct": {"noise_sigma": 0.04, "resolution": 0.02},
    "N2_pct": {"noise_sigma": 0.04, "resolution": 0.02},
    "EGT_C": {"noise_sigma": 1.0, "resolution": 0.5},
    "FF_kgph": {"noise_share": 0.004, "resolution": 1.0},
}
STRETCH_S: Final = 240.0  # one window of an unlogged switch in each


def outputs_of(channels: Mapping[str, FloatArray]) -> tuple[str, ...]:
    """Names of the outputs among channels: without a lever, the fuel flow drives and is none."""
    names = OUTPUTS if "TRA_deg" in channels else OUTPUTS[:3]
    return tuple(name for name in names if name in channels)


class Content(NamedTuple):
    """What a case holds, in numbers: doses of effects, and the size of what is strange."""

    doses: tuple[Dose, ...] = ()
    strange: float = 0.0


NOTHING: Final = Content()


class Flight(NamedTuple):
    """What is given of one flight, `(time,)` each, and the windows of a hidden switch.

    That is its inputs with their time, or all channels of a simulator's log.
    """

    number: int
    inputs: Channels
    windows: Windows

    @property
    def dt_s(self) -> float:
        return float(self.inputs["time_s"][1] - self.inputs["time_s"][0])


class Specimen:
    """The case with its flights: what the simulator says, what is so, and what is recorded.

    Sensors have the lags `lags_s`, by channel.
    """

    def __init__(self, case: Case, plan: BlindPlan, lags_s: Mapping[str, float] = LAGS_S) -> None:
        self.case, self.plan = case, plan
        self.build = build_scatter(self._random("build", 0), case.base.build_pct)
        lags = {name: ChannelSensor(tau_s=tau_s) for name, tau_s in lags_s.items()}
        white = {name: lag.model_copy(update=_WHITE[name]) for name, lag in lags.items()}
        self._perfect = SensorConfig(preset="perfect", channels=lags)
        self._sensors = (
            SensorConfig(preset="perfect", channels=white)
            if plan.build == "same"
            else SensorConfig(channels=lags)
        )

    def flight(self, number: int) -> Flight:
        random = self._random("flight", number)
        plan = FlightPlan.parse({
            "style": self.case.style,
            "aircraft": "business_jet" if self.case.engine in KINDS else self.case.engine,
            "duration_s": self.plan.duration_s,
            "rate_hz": self.plan.rate_hz,
        })  # fmt: skip
        inputs = dict(plan_flight(plan, int(random.integers(2**31)))["left"])
        if self.case.engine == "lumped_fuel":
            inputs = _fuelled(inputs)
        windows = drawn_windows(random, float(inputs["time_s"][-1]), STRETCH_S)
        return Flight(number, inputs, windows)

    def simulated(
        self, flight: Flight, content: Content = NOTHING, *, built: bool = False
    ) -> Channels:
        """What the simulator says, `(time,)`, with the case's content added where it is given.

        With `built` it has the build and the parameters of the real engine.
        """
        base = Base(0.0) if built else self.case.base
        inside = [each.unmodelled(flight.windows) for each in content.doses if not each.on_sensor]
        ids = {each.id: each for each in inside}
        for name, factor in (("heat_soak", base.soak), ("spool_lag", base.inertia)):
            # On top of a simulator that is off by a factor itself.
            before = ids.get(name, Unmodelled(name)).value("factor")
            ids[name] = Unmodelled(name, {"factor": before * factor})
        engine = self._engine(self.build if built else None, list(ids.values()), base.probe)
        return self._shown(self._run(engine, flight, content), flight, content, self._perfect)

    def both(self, flight: Flight, content: Content) -> tuple[Channels, Channels]:
        """What is so, as sensors without noise show it with their faults; and what is recorded."""
        real = self._real(flight, content)
        return (
            self._shown(real, flight, content, self._perfect),
            self._shown(real, flight, content, self._sensors),
        )

    def _real(self, flight: Flight, content: Content) -> Channels:
        inside = [each.unmodelled(flight.windows) for each in content.doses if not each.on_sensor]
        engine = self._engine(self.build, inside)
        return self._run(engine, flight, content, misfit=self.case.base.misfit)

    def _engine(
        self, build: Health | None, inside: Sequence[Unmodelled], probe: float = 1.0
    ) -> Engine:
        """The case's engine with a build and effects; `probe` multiplies its probe's lag."""
        if self.case.engine in KINDS:
            return LumpedEngine(self.case.engine, build, inside, probe)
        engine = VirtualEngine(self.case.engine, build, inside)
        tau_s = engine.settings.body.probe_tau_s * probe
        engine.settings = replace(
            engine.settings, body=engine.settings.body._replace(probe_tau_s=tau_s)
        )
        return engine

    def _run(
        self, engine: Engine, flight: Flight, content: Content, *, misfit: bool = False
    ) -> Channels:
        """Inputs as the engine hears them, through the engine, to what it gives."""
        changes = list(MISFIT) if misfit else []
        if self.case.strange is not None and content.strange:
            changes.append((self.case.strange, content.strange))
        arriving = dict(flight.inputs)
        for what, size in changes:
            arriving = applied(what, "input", arriving, size)
        inputs = {name: arriving[name] for name in engine.input_names}
        outputs = engine.simulate(inputs, flight.dt_s)
        seen = {**flight.inputs, **{name: outputs[name] for name in OUTPUTS}}
        for what, size in changes:
            seen = applied(what, "output", seen, size)
        return seen | flight.inputs

    def _shown(
        self, seen: Channels, flight: Flight, content: Content, sensors: SensorConfig
    ) -> Channels:
        faults = [each.fault(self.case.engine) for each in content.doses if each.on_sensor]
        outputs = {name: seen[name] for name in outputs_of(seen)}
        streams = Streams(self._seed(flight), flight.number, 0)
        return seen | record(outputs, flight.dt_s, sensors, streams, faults).channels

    def _seed(self, flight: Flight) -> int:
        """Seed of the sensors' noise."""
        return int(self._random("sensors", flight.number).integers(2**31))

    def _random(self, purpose: str, number: int) -> np.random.Generator:
        code = int.from_bytes(purpose.encode()[:4], "big")
        return drawn(self.plan, 1, self.case.number, code, number)


def _fuelled(inputs: Channels) -> Channels:
    """Inputs with the fuel flow that a governed engine would take in the place of its lever."""
    dt_s = float(inputs["time_s"][1] - inputs["time_s"][0])
    fuel = LumpedEngine("lumped_n2").simulate(inputs, dt_s)["FF_kgph"]
    changed = {**inputs, "TRA_deg": fuel}
    return {("FF_kgph" if n == "TRA_deg" else n): values for n, values in changed.items()}
