"""The Citation X paper's mesh of virtual flights, and its static models: tables 5, 6 and 8 to 13.

Section 2.3: accelerated cruise at constant altitude and throttle lever angle (TLA) for the static
models; steps, impulses and ramps of the lever from trim for the dynamic ones; identification and
validation flights apart; low and high altitudes apart, because the range of TLA differs.

The paper's tables of cases (1 to 4, 7) are lost. Known from its text: TLA 50 is the climb position,
35 the least at the highest altitude; accelerations start at TLA 25 (low) and 35 (high). Chosen
here, before a model was fitted to it: the nodes of identification, validation in the middle of
every cell, `TRA = 85/60 TLA`, a ceiling of 40,000 ft (the virtual engine's), T_s = 0.1 s and a ramp
of 5 s. The paper gives the onset as t = 1 s (eqs 1 to 3) and as t = 0: here it is explicit.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise, product
from typing import Any, Literal

import numpy as np

from narxcal import static_models as models
from narxcal.atmosphere import P0_PA, SOUND_KT, isa
from narxcal.static_models.model import Columns, StaticModel
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import DataError, ModelError
from narxcal.turbofan import VirtualEngine, build_scatter
from training.steady.static_fit import (
    SEARCHES,
    Estimator,
    FitSettings,
    StaticFit,
    StaticScore,
    fit,
    fit_correction,
    score,
)

Kind = Literal["step", "impulse", "ramp"]
Role = Literal["identification", "validation"]
KINDS: tuple[Kind, ...] = ("step", "impulse", "ramp")
TRA_PER_TLA = 85.0 / 60.0
TLA_MOST = 50.0
T_S = 0.1
RAMP_S, ONSET_S = 5.0, 1.0
TIME_S: FloatArray = T_S * np.arange(300, dtype=np.float64)
MOVED = int(np.argmax(TIME_S > ONSET_S))  # first sample at which a disturbed lever has moved
_POINTS = 24  # Mach numbers of a cruise
_SLOW_KT, _FAST_KT, _MACH_MOST = 200.0, 330.0, 0.85
DRIVERS = ("TRA_deg", "ALT_ft", "Mach", "dT_C", "ECS")
OUTPUTS = ("FPR", "EPR", "EGT_C", "FN_kN", "FF_kgph")


@dataclass(frozen=True)
class Region:
    """Nodes of identification of one of the two meshes."""

    name: str
    altitudes_ft: tuple[float, ...]
    tla_deg: tuple[float, ...]

    def nodes(self, role: Role) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Altitudes and lever angles of the flights of `role`."""
        if role == "identification":
            return self.altitudes_ft, self.tla_deg
        return _middles(self.altitudes_ft), _middles(self.tla_deg)

    def conditions(self, role: Role) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Altitudes and amplitudes (of the TLA, from the least) of the disturbances of `role`."""
        altitudes, _ = self.nodes(role)
        amplitudes = tuple(tla - self.least_tla for tla in self.tla_deg[1:])
        return altitudes, amplitudes if role == "identification" else _middles(amplitudes)

    @property
    def least_tla(self) -> float:
        """Where the disturbances start."""
        return self.tla_deg[0]


LOW = Region("low", (5e3, 10e3, 15e3, 20e3, 25e3), (25.0, 30.0, 35.0, 40.0, 45.0, 50.0))
HIGH = Region("high", (30e3, 32.5e3, 35e3, 37.5e3, 40e3), (35.0, 40.0, 45.0, 50.0))
REGIONS = (LOW, HIGH)


@dataclass(frozen=True, eq=False)
class Disturbance:
    """One flight with a disturbed lever; `columns` (time,) every T_S."""

    kind: Kind
    altitude_ft: float
    amplitude_deg: float  # of the TLA
    columns: Mapping[str, FloatArray]


def static_flights(engine: VirtualEngine, region: Region, role: Role) -> dict[str, FloatArray]:
    """Steady points of all accelerated cruises of `region`; `flight` numbers the flights.

    A cruise takes 50 s to change its speed, the engine about one to follow: its samples are taken
    for steady.
    """
    found = []
    for number, (alt_ft, tla) in enumerate(product(*region.nodes(role))):
        mach = np.linspace(*mach_range(region, alt_ft, tla), _POINTS)
        inputs = _inputs(engine, alt_ft, mach, np.full(_POINTS, tla))
        outputs = engine.outputs(np.column_stack(list(inputs.values())))
        columns = dict(zip(engine.output_names, outputs.T, strict=True))
        found.append(_columns(inputs, columns) | {"flight": np.full(_POINTS, float(number))})
    return {name: np.concatenate([part[name] for part in found]) for name in found[0]}


def disturbances(
    engine: VirtualEngine, region: Region, role: Role, kind: Kind
) -> list[Disturbance]:
    """All flights of one kind, from the least TLA at the Mach number that it sustains.

    In row-major order of `region.conditions(role)`.
    """
    found = []
    for alt_ft, amplitude in product(*region.conditions(role)):
        mach = np.full_like(TIME_S, mach_range(region, alt_ft, region.least_tla)[1])
        tla = lever(kind, TIME_S, region.least_tla, amplitude)
        inputs = _inputs(engine, alt_ft, mach, tla)
        columns = _columns(inputs, engine.simulate(inputs, T_S))
        found.append(Disturbance(kind, alt_ft, amplitude, columns))
    return found


def lever(kind: Kind, time_s: FloatArray, start: float, amplitude: float) -> FloatArray:
    """Lever (time,) of equations 1 to 3; the ramp is a reconstruction and lasts 5 s."""
    late = time_s - ONSET_S
    share = {
        "step": (late > 0.0).astype(np.float64),
        "impulse": ((late > 0.0) & (late < 1.5 * T_S)).astype(np.float64),
        "ramp": np.clip(late / RAMP_S, 0.0, 1.0),
    }[kind]
    return np.asarray(start + amplitude * share)


def mach_range(region: Region, alt_ft: float, tla_deg: float) -> tuple[float, float]:
    """Mach at which an accelerated cruise begins, and the one that the lever sustains.

    From 200 kt calibrated to a speed that grows with the lever, at most 330 kt and Mach 0.85.
    """
    slow = _mach(_SLOW_KT, alt_ft)
    most = min(_mach(_FAST_KT, alt_ft), _MACH_MOST)
    share = (tla_deg - region.least_tla) / (TLA_MOST - region.least_tla)
    return slow, slow + (0.4 + 0.6 * share) * (most - slow)


def _mach(cas_kt: float, alt_ft: float) -> float:
    impact = P0_PA * ((1.0 + 0.2 * (cas_kt / SOUND_KT) ** 2) ** 3.5 - 1.0)
    return float(np.sqrt(5.0 * ((1.0 + impact / isa(alt_ft)[1]) ** (2.0 / 7.0) - 1.0)))


def _inputs(
    engine: VirtualEngine, alt_ft: float, mach: FloatArray, tla_deg: FloatArray
) -> dict[str, FloatArray]:
    """In the engine's order; packs on, standard day."""
    given = {
        "TRA_deg": TRA_PER_TLA * tla_deg,
        "ALT_ft": np.full_like(mach, alt_ft),
        "Mach": mach,
        "ECS": np.ones_like(mach),
    }
    return {name: given.get(name, np.zeros_like(mach)) for name in engine.input_names}


def _columns(
    inputs: Mapping[str, FloatArray], outputs: Mapping[str, FloatArray]
) -> dict[str, FloatArray]:
    return {name: inputs[name] for name in DRIVERS} | {name: outputs[name] for name in OUTPUTS}


def _middles(nodes: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(0.5 * (a + b) for a, b in pairwise(nodes))


BEST_THRUST = "Cold Thrust + correction (M, FPR)"
PRESSURES = ("FPR", "EPR", "EGT_C")  # modelled by black boxes alone, as in the paper
_BUILD = 1  # seed of the flown engine's build; the CLM is the engine as designed
_AREA_PER_KN = 0.01  # m^2/kN: start value of the cold stream's area
_MOST_DEGREE = 5


@dataclass(frozen=True, eq=False)
class Engines:
    """Flown engine, its design (the CLM), and the ratings that the laws start from."""

    name: str

    @cached_property
    def flown(self) -> VirtualEngine:
        """Engine with the build scatter of 0.5 % in every component."""
        return VirtualEngine(self.name, build_scatter(np.random.default_rng(_BUILD)))

    @cached_property
    def designed(self) -> VirtualEngine:
        return VirtualEngine(self.name)

    @cached_property
    def F0_kN(self) -> float:  # noqa: N802 - the paper's symbol
        """Take-off thrust at sea level."""
        take_off = np.array([[85.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0]])
        return round(float(self.designed.outputs(take_off)[0, 4]), 1)

    @property
    def bypass_ratio(self) -> float:
        return float(self.designed.preset.point.bypass_ratio)


@dataclass(frozen=True, eq=False)
class StaticRow:
    """One model in one region: its fit, and its score on validation flights.

    `chained` is the score with FPR, EPR, ITT (and thrust) predicted too, as in Fig. 9. `failure`
    says why a model has no fit.
    """

    region: str
    output: str
    model: str
    failure: str = ""
    validation: StaticScore | None = None
    chained: StaticScore | None = None
    fit: StaticFit | None = None

    def document(self) -> dict[str, Any]:
        """As JSON."""
        scores = {name: getattr(self, name) for name in ("validation", "chained")}
        return {
            **{name: getattr(self, name) for name in ("region", "output", "model", "failure")},
            **{name: vars(found) if found else None for name, found in scores.items()},
            "fit": self.fit.document() if self.fit else None,
        }


@dataclass(frozen=True, eq=False)
class RegionStudy:
    """What was fitted to the flights of one region.

    `chain` are FPR, EPR, ITT, thrust, fuel, each fed by those before it; `searches` every grey box
    by every estimator, without drag; `degrees` of the correction as `correction_degrees` has them.
    """

    region: Region
    validation: Columns
    rows: tuple[StaticRow, ...]
    chain: tuple[StaticFit, ...]
    searches: tuple[StaticRow, ...]
    degrees: tuple[tuple[int, float, float, float], ...]

    def row(self, output: str, model: str) -> StaticRow:
        return next(r for r in self.rows if (r.output, r.model) == (output, model))

    def search(self, model: str, estimator: str) -> StaticRow | None:
        """Row of a model by one estimator; None where it was not run or has no fit."""
        wanted = (
            r for r in self.searches if r.fit and (r.model, r.fit.estimator) == (model, estimator)
        )
        return next(wanted, None)


def static_study(
    engines: Engines, region: Region, estimators: Sequence[Estimator] = SEARCHES
) -> RegionStudy:
    """Fit every static model to the identification flights and score it on the others."""
    known = static_flights(engines.flown, region, "identification")
    new = static_flights(engines.flown, region, "validation")
    nodes = {"TRA_deg": [TRA_PER_TLA * tla for tla in region.tla_deg],
             "ALT_ft": region.altitudes_ft}  # fmt: skip
    tables = [fit(models.spline_table(known, name, nodes), known) for name in PRESSURES]
    degrees = correction_degrees(cold_thrust(engines), known)
    best = min(degrees, key=lambda row: row[2])[0]
    thrust = with_correction(fit(cold_thrust(engines), known), known, best)
    chain = (*tables, thrust, fit(models.yoder_plus(engines.F0_kN), known))
    through = {**new, **chained(chain, new)}

    def scored(found: StaticFit, name: str, inputs: Columns = through) -> StaticRow:
        output = found.model.output
        validation, through_chain = (score(found.predict(x), new[output]) for x in (new, inputs))
        return StaticRow(region.name, output, name, "", validation, through_chain, found)

    def attempt(model: StaticModel, settings: FitSettings) -> StaticRow:
        try:
            return scored(fit(model, known, settings), model.name)
        except (DataError, ModelError) as error:
            return StaticRow(region.name, model.output, model.name, str(error))

    grey = [*thrust_models(engines), *fuel_models(engines)]
    rows = [
        *(scored(fit(box, known), name, new) for name, box in _black_boxes(known, nodes)),
        *(attempt(*law) for law in grey),
        scored(thrust, BEST_THRUST),
    ]
    searches = [
        attempt(model, replace(settings, estimator=name))
        for model, settings in grey
        if "CLM" not in model.name and "drag" not in model.name
        for name in estimators
    ]
    return RegionStudy(region, new, tuple(rows), chain, tuple(searches), tuple(degrees))


def chained(chain: Sequence[StaticFit], columns: Columns) -> dict[str, FloatArray]:
    """Predict output by output, each from the drivers and the outputs predicted before (Fig. 9)."""
    known = {name: columns[name] for name in DRIVERS}
    for part in chain:
        known[part.model.output] = part.predict(known)
    return {part.model.output: known[part.model.output] for part in chain}


def correction_degrees(
    base: StaticModel, columns: Columns
) -> list[tuple[int, float, float, float]]:
    """Degree, identification error, and mean and largest error of a flight left out, in %."""
    degrees = range(1, _MOST_DEGREE + 1)
    predicted = np.empty((_MOST_DEGREE, len(columns["flight"])))
    for flight in np.unique(columns["flight"]):
        out = columns["flight"] == flight
        rest, left = ({name: v[rows] for name, v in columns.items()} for rows in (~out, out))
        theory = fit(base, rest)
        for k, degree in enumerate(degrees):
            predicted[k, out] = with_correction(theory, rest, degree).predict(left)
    theory, table = fit(base, columns), []
    for degree, values in zip(degrees, predicted, strict=True):
        left_out = score(values, columns[base.output])
        known = with_correction(theory, columns, degree).score
        table.append((degree, known.mean_pct, left_out.mean_pct, left_out.max_pct))
    return table


def with_correction(theory: StaticFit, columns: Columns, degree: int) -> StaticFit:
    """Add to a fitted model a correction in (Mach, FPR) of one degree in both."""
    term = models.polynomial(columns, theory.model.output, {"Mach": degree, "FPR": degree})
    return fit_correction(models.corrected(theory.model, term), theory, columns)


_EFFICIENCIES = {"eta_j": 0.97, "eta_t": 0.88, "eta_c": 0.85, "eta_i": 0.97}


def thrust_models(engines: Engines) -> list[tuple[StaticModel, FitSettings]]:
    """Thrust laws with and without drag, Cold Thrust in its forms, CLM.

    Torenbeek's law has its bypass ratio free: with the EPR of a turbofan for the pressure ratio of
    its gas generator, the true one leaves no fit.
    """
    F0, B, S = engines.F0_kN, engines.bypass_ratio, _AREA_PER_KN * engines.F0_kN
    usual, free_B = FitSettings(), FitSettings(fixed=_EFFICIENCIES)
    torenbeek = models.torenbeek(F0, B, density_exponent=True, throttle_degree=2)
    laws = [
        (models.mattingly(F0), usual), (torenbeek.with_start("B", 1.0), free_B),
        (models.aerospatiale(F0), usual), (models.wanner(F0), usual),
    ]  # fmt: skip
    rest = [
        models.cold_thrust(2.0 * S, variant="paper").renamed("Cold Thrust (paper)"),
        models.cold_thrust(2.0 * S).renamed("Cold Thrust (full)"),
        cold_thrust(engines),
        models.component_level(engines.designed, "FN_kN", DRIVERS),
    ]
    drag = [(models.with_drag(law, 2, 3.0 * S), settings) for law, settings in laws]
    return [*laws, *drag, *((model, usual) for model in rest)]


def cold_thrust(engines: Engines) -> StaticModel:
    """Cold Thrust that is chosen: full, with the flow that a fixed fan nozzle passes."""
    return models.cold_thrust(_AREA_PER_KN * engines.F0_kN, flow="nozzle")


def fuel_models(engines: Engines) -> list[tuple[StaticModel, FitSettings]]:
    """Torenbeek with free scale and bypass ratio, BADA, Yoder, Yoder+, CLM."""
    torenbeek = models.torenbeek_fuel(engines.bypass_ratio).with_start("k", 0.3)
    rest = [
        models.bada3(),
        models.yoder(engines.F0_kN),
        models.yoder_plus(engines.F0_kN),
        models.component_level(engines.designed, "FF_kgph", DRIVERS),
    ]
    free = FitSettings(fixed=_EFFICIENCIES)
    return [(torenbeek.with_start("B", 1.0), free), *((model, FitSettings()) for model in rest)]


def _black_boxes(
    known: Columns, nodes: dict[str, Sequence[float]]
) -> Iterator[tuple[str, StaticModel]]:
    """Polynomials of degree 1 to 3 in every input, and tables with lines and splines."""
    for output in (*PRESSURES, "FN_kN", "FF_kgph"):
        for n in (1, 2, 3):
            degrees = dict.fromkeys(("Mach", "ALT_ft", "TRA_deg"), n)
            yield f"polynomial {n}", models.polynomial(known, output, degrees)
        yield "linear table", models.spline_table(known, output, nodes, degree=1)
        yield "spline table", models.spline_table(known, output, nodes)
