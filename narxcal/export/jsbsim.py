"""The turbine of JSBSim fitted to a run: what that form holds, and by how much it fails.

JSBSim's turbine (FGTurbine) settles at speeds that are linear in the throttle position, and moves
towards them at rates that are a function of the speed alone:

    N_settled = idle + position (max - idle),   dN/dt = up(N) or -down(N) until it is there

Idle and maximum are those of the run at sea level on a standard day. The position is the share of
N2's way between them, so that N2 settles as in the run there. The rates at nodes of the speed are
fitted by least squares to free runs of the model at sea level over the levers of logs, in speeds
straightened over the position, so that steady differences of N1 do not count.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self
from xml.etree.ElementTree import Comment, Element, SubElement, indent, tostring

import numpy as np
from scipy.optimize import least_squares

from narxcal.calibration.calibration import Calibration
from narxcal.export.proof import Case, held
from narxcal.steady.model import Envelope
from narxcal.support.arrays import FloatArray
from narxcal.support.compiled import compiled, table_value
from narxcal.support.errors import ModelError

SPOOLS = ("N1_pct", "N2_pct")
BOUND = 1e-6  # of idle and maximum speeds in JSBSim, %
_NODES = 8  # of the rates over the speed
# A fit begins at 10 %/s. A rate e times its neighbour costs as much as 0.03 % RMS of the speed.
_START, _SMOOTH = np.log(10.0), 0.03
_BEFORE_S, _AFTER_S, _POINTS = 30.0, 120.0, 201
_STEPS = 5  # of JSBSim per sample
_SMALL, _HIGH_FT = 0.1, 20_000.0


@dataclass(frozen=True, eq=False)
class Turbine:
    """JSBSim's turbine: `throttle` (n,) positions over the run's `lever` (n,), speeds, rates.

    `idle` and `top` are speeds [%] by spool; `nodes` and `rates` those between which JSBSim
    interpolates [%, %/s], by function. `base` (n_in,) are the run's inputs at sea level.
    """

    driver: str
    lever: FloatArray
    throttle: FloatArray
    idle: Mapping[str, float]
    top: Mapping[str, float]
    tables: Mapping[str, tuple[FloatArray, FloatArray]]
    base: FloatArray
    thrust_kN: tuple[float, float] | None

    @classmethod
    def of(cls, model: Calibration, envelope: Envelope, cases: Sequence[Case]) -> Self:
        """Fit the turbine to a model over cases; `ModelError` for one without spool speeds."""
        names, outputs = model.input_names, model.output_names
        spools = [name for name in SPOOLS if name in outputs]
        if not spools:
            raise ModelError(
                f"JSBSim's turbine has spool speeds, and the outputs are {', '.join(outputs)}",
                hint="Export it as C or FMU",
            )
        driver = next((name for name in ("TRA_deg", "FF_kgph") if name in names), names[0])
        base, column = envelope.clamp(np.zeros(len(names))), names.index(driver)
        lever = np.linspace(envelope.low[column], envelope.high[column], _POINTS)
        given = np.tile(base, (len(lever), 1))
        given[:, column] = lever
        valid = model.steady.inside(given)
        lever, given = lever[valid], given[valid]
        if len(lever) < 2:
            raise ModelError(
                "the model is valid at no two levers at sea level", hint="Export it as C or FMU"
            )
        ss = model.steady.outputs(given)
        last = np.maximum.accumulate(ss[:, outputs.index(spools[-1])])
        # A turbine of one spool turns both of JSBSim's.
        of = {name: outputs.index(name if name in spools else spools[0]) for name in SPOOLS}
        ends, throttle = ss[[0, -1]], (last - last[0]) / (last[-1] - last[0])
        moves = [_at_sea_level(model, given, held(case.inputs)[:, column]) for case in cases]
        tables = {}
        for name, at in of.items():
            line = ends[0, at] + throttle * (ends[1, at] - ends[0, at])
            settled = np.maximum.accumulate(ss[:, at])
            pairs = [
                (np.interp(moved, lever, line), np.interp(run[:, at], settled, line))
                for moved, run in moves
            ]
            nodes, up, down = _fitted_rates(pairs, model.dt_s, (line[0], line[-1]))
            tables[f"{name[:2]}SpoolUp"], tables[f"{name[:2]}SpoolDown"] = (
                (nodes, up),
                (nodes, down),
            )
        thrust = ends[:, outputs.index("FN_kN")] if "FN_kN" in outputs else None
        return cls(
            driver, lever, throttle,
            {name: float(ends[0, at]) for name, at in of.items()},
            {name: float(ends[1, at]) for name, at in of.items()},
            tables, base, None if thrust is None else (float(thrust[0]), float(thrust[1])),
        )  # fmt: skip

    def position(self, lever: FloatArray) -> FloatArray:
        return np.asarray(np.interp(lever, self.lever, self.throttle))

    def to_json(self) -> dict[str, Any]:
        position = {"lever": self.lever.tolist(), "position": self.throttle.tolist()}
        return {"driver": self.driver, **position}

    def xml(self, about: Sequence[str]) -> bytes:
        """The file `engine/NAME.xml` of JSBSim."""
        root = Element("turbine_engine", {"name": "narxcal"})
        root.append(Comment(f" {'; '.join(about).replace('--', '-')} "))
        if self.thrust_kN is None:
            root.append(Comment(" The run has no thrust: milthrust and IdleThrust are examples. "))
        idle, top = self.thrust_kN or (0.5, 10.0)
        SubElement(root, "milthrust", {"unit": "N"}).text = repr(1e3 * top)
        for name, spools in (("idle", self.idle), ("max", self.top)):
            for spool, value in spools.items():
                SubElement(root, f"{name}{spool[:2].lower()}").text = repr(value)
        for name, value in (("IdleThrust", idle / top), ("MilThrust", 1.0)):
            SubElement(SubElement(root, "function", {"name": name}), "value").text = repr(value)
        for name, (nodes, rates) in self.tables.items():
            table = SubElement(SubElement(root, "function", {"name": name}), "table")
            spool = f"propulsion/engine[#]/{name[:2].lower()}"
            SubElement(table, "independentVar", {"lookup": "row"}).text = spool
            rows = [f"{n:.9g} {r:.9g}" for n, r in zip(nodes, rates, strict=True)]
            SubElement(table, "tableData").text = "\n" + "\n".join(rows) + "\n"
        pairs = zip(self.lever[::20], self.throttle[::20], strict=True)
        rows = [f"{lever:.6g} {position:.6g}" for lever, position in pairs]
        root.append(Comment(f" {self.driver}, throttle position: {'; '.join(rows)} "))
        indent(root)
        found: bytes = tostring(root, encoding="UTF-8", xml_declaration=True) + b"\n"
        return found


def _step(model: Calibration, before: FloatArray, after: FloatArray) -> FloatArray:
    """Outputs of the run from a step on, out of equilibrium."""
    counts = round(_BEFORE_S / model.dt_s), round(_AFTER_S / model.dt_s)
    inputs = np.vstack([np.tile(before, (counts[0], 1)), np.tile(after, (counts[1], 1))])
    return model.simulate(inputs)[counts[0] - 1 :]


def crossings(speed: FloatArray, shares: FloatArray, dt_s: float) -> FloatArray:
    """Times at which a speed first has gone shares of its way from its first to its last value."""
    gone = np.maximum.accumulate((speed - speed[0]) / (speed[-1] - speed[0]))
    return np.asarray(np.interp(shares, gone, np.arange(len(gone)) * dt_s))


def _at_sea_level(
    model: Calibration, given: FloatArray, lever: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Levers within those of `given` (n, n_in), and the model's run over them at sea level."""
    column = int(np.argmax(np.ptp(given, axis=0)))
    moved = np.clip(lever, given[0, column], given[-1, column])
    inputs = np.tile(given[0], (len(moved), 1))
    inputs[:, column] = moved
    return moved, model.simulate(inputs)


@compiled
def _seek(
    target: FloatArray, start: float, tables: tuple[FloatArray, FloatArray, FloatArray], dt_s: float
) -> FloatArray:
    """Speed of JSBSim's turbine behind settled speeds (time,); `tables` are nodes, up and down."""
    nodes, up, down = tables
    found, speed, h = np.empty(len(target)), start, dt_s / 5
    for k in range(len(target)):
        for _ in range(5 if k else 0):
            if speed < target[k]:
                speed = min(speed + h * table_value(speed, nodes, up), target[k])
            else:
                speed = max(speed - h * table_value(speed, nodes, down), target[k])
        found[k] = speed
    return found


def _fitted_rates(
    pairs: Sequence[tuple[FloatArray, FloatArray]], dt_s: float, ends: tuple[float, float]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Nodes, and rates up and down at them, that follow pairs of settled and run speeds best."""
    nodes = np.linspace(*ends, _NODES)
    smooth = _SMOOTH * np.sqrt(sum(len(run) for _, run in pairs))

    def residual(logs: FloatArray) -> FloatArray:
        rates = np.exp(logs).reshape(2, -1)
        tables = (nodes, np.ascontiguousarray(rates[0]), np.ascontiguousarray(rates[1]))
        off = [_seek(goal, run[0], tables, dt_s) - run for goal, run in pairs]
        return np.concatenate([*off, smooth * np.diff(np.log(rates), axis=1).ravel()])

    start = np.full(2 * _NODES, _START)
    # Where runs show nothing a spool must still come to rest: it crosses its range in half the time
    # after which it is read.
    slowest = (ends[1] - ends[0]) / (0.5 * _AFTER_S)
    fit = least_squares(residual, start, bounds=(np.log(slowest), np.log(200.0)), max_nfev=40)
    up, down = np.exp(fit.x).reshape(2, -1)
    return nodes, up, down


_RIG = """<?xml version="1.0"?>
<fdm_config name="rig" version="2.0">
<metrics><wingarea> 1 </wingarea><wingspan> 1 </wingspan><chord> 1 </chord>
<location name="AERORP"><x>0</x><y>0</y><z>0</z></location></metrics>
<mass_balance><ixx> 1 </ixx><iyy> 1 </iyy><izz> 1 </izz><emptywt> 1000 </emptywt>
<location name="CG"><x>0</x><y>0</y><z>0</z></location></mass_balance>
<ground_reactions/>
<propulsion><engine file="engine"><feed>0</feed><thruster file="direct">
<location><x>0</x><y>0</y><z>0</z></location></thruster></engine>
<tank type="FUEL"><location><x>0</x><y>0</y><z>0</z></location>
<capacity> 1e9 </capacity><contents> 1e9 </contents></tank></propulsion>
<aerodynamics><axis name="DRAG"/><axis name="ROLL"/></aerodynamics>
</fdm_config>
"""


def runtime() -> Any:
    """The module jsbsim, None where it is not installed."""
    try:
        import jsbsim  # noqa: PLC0415  (no extra of narxcal has it)
    except ImportError:
        return None
    return jsbsim


class Rig:
    """JSBSim with the turbine on a stand: nothing moves but the engine."""

    def __init__(self, engine: bytes, dt_s: float) -> None:
        files = {
            "engine/engine.xml": engine,
            "engine/direct.xml": b"<?xml version='1.0'?>\n<direct name='direct'/>\n",
            "aircraft/rig/rig.xml": _RIG.encode("utf-8"),
        }
        module = runtime()
        module.FGJSBBase().debug_lvl = 0
        with tempfile.TemporaryDirectory(prefix="narxcal_jsbsim_") as folder:
            for name, data in files.items():
                (Path(folder) / name).parent.mkdir(parents=True, exist_ok=True)
                (Path(folder) / name).write_bytes(data)
            self.fdm: Any = module.FGFDMExec(folder)
            self.fdm.set_debug_level(0)
            self.fdm.load_model("rig")
        self.fdm.set_dt(dt_s)
        self.fdm.run_ic()
        self.fdm["propulsion/set-running"] = -1
        for kind in ("rate", "position"):
            for axis in ("translational", "rotational"):
                self.fdm[f"simulation/integrator/{kind}/{axis}"] = 0

    def step(self, throttle: float, count: int = 1) -> tuple[float, float]:
        """N1 and N2 after `count` steps at a throttle position."""
        self.fdm["fcs/throttle-cmd-norm[0]"] = throttle
        for _ in range(count):
            self.fdm.run()
        return self.fdm["propulsion/engine[0]/n1"], self.fdm["propulsion/engine[0]/n2"]

    def run(self, throttle: FloatArray, settle_s: float = _AFTER_S) -> FloatArray:
        """N1 and N2 (time, 2) over throttle positions, from equilibrium at the first."""
        first = self.step(float(throttle[0]), round(settle_s / self.fdm.get_delta_t()))
        rows = [self.step(position, _STEPS) for position in throttle[1:].tolist()]
        return np.array([first, *rows])


def compare(
    model: Calibration, turbine: Turbine, engine: bytes, cases: Sequence[Case]
) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """JSBSim's idle and maximum speeds next to the run's, and what its form does not hold.

    The latter: steady speeds over the throttle at sea level and at 20 000 ft, the time to 90 % of
    slam, chop and of a step of a tenth, and free runs over the levers of cases.
    """
    rig, outputs = Rig(engine, model.dt_s / _STEPS), model.output_names
    rows: list[dict[str, Any]] = []
    for what, position, speeds in (("idle", 0.0, turbine.idle), ("maximum", 1.0, turbine.top)):
        found = dict(zip(SPOOLS, rig.run(np.full(2, position))[0].tolist(), strict=True))
        off = {name: abs(found[name] - speeds[name]) for name in SPOOLS}
        rows.append({"log": "sea level", "engine": "", "what": what, "samples": 1, "largest": off})
    lever, at = model.input_names.index(turbine.driver), _columns(model)
    rms = {}
    for case in cases:
        inputs = held(case.inputs)
        flown = rig.run(turbine.position(inputs[:, lever]))
        error = flown[:, [SPOOLS.index(outputs[k]) for k in at]] - model.simulate(inputs)[:, at]
        rms[case.name] = _by_spool(outputs, at, np.sqrt(np.mean(error**2, axis=0)))
    moves = {"slam": (0.0, 1.0), "chop": (1.0, 0.0), "step of a tenth": (0.5, 0.5 + _SMALL)}
    t90 = {what: _t90(model, turbine, rig, pair) for what, pair in moves.items()}
    return rows, {"largest": _steady_misfit(model, turbine), "t90_s": t90, "rms": rms}


def _columns(model: Calibration) -> list[int]:
    return [model.output_names.index(name) for name in SPOOLS if name in model.output_names]


def _steady_misfit(model: Calibration, turbine: Turbine) -> dict[str, dict[str, float]]:
    """Largest differences of settled speeds from lines over the throttle position."""
    names, outputs, at = model.input_names, model.output_names, _columns(model)
    given = np.tile(turbine.base, (len(turbine.lever), 1))
    given[:, names.index(turbine.driver)] = turbine.lever
    ends = [(turbine.idle[outputs[k]], turbine.top[outputs[k]]) for k in at]
    line = np.array([low + turbine.throttle * (high - low) for low, high in ends]).T
    misfit, heights = {}, {"sea level": turbine.base, "20 000 ft": turbine.base.copy()}
    if "ALT_ft" in names:
        heights["20 000 ft"][names.index("ALT_ft")] = _HIGH_FT
    for where, base in heights.items():
        there = np.where(np.arange(len(names)) == names.index(turbine.driver), given, base)
        inside = model.steady.inside(there)
        if inside.any() and (where == "sea level" or "ALT_ft" in names):
            off = np.abs(model.steady.outputs(there)[:, at] - line)[inside]
            misfit[f"steady at {where}"] = _by_spool(outputs, at, off.max(axis=0))
    return misfit


def _by_spool(outputs: Sequence[str], at: Sequence[int], values: FloatArray) -> dict[str, float]:
    return {outputs[k]: float(value) for k, value in zip(at, values, strict=True)}


def _t90(
    model: Calibration, turbine: Turbine, rig: Rig, throttle: tuple[float, float]
) -> dict[str, Any]:
    """Time to 90 % of a move of the throttle, by spool: of the run and of JSBSim."""
    ends = np.tile(turbine.base, (2, 1))
    ends[:, model.input_names.index(turbine.driver)] = np.interp(
        throttle, turbine.throttle, turbine.lever
    )
    ours = _step(model, *ends)
    theirs = rig.run(np.array([throttle[0], *[throttle[1]] * (len(ours) - 1)]))
    found = {}
    for k, name in enumerate(SPOOLS):
        if name in model.output_names:
            pair = ours[:, model.output_names.index(name)], theirs[:, k]
            run, jsbsim = (float(crossings(p, np.array([0.9]), model.dt_s)[0]) for p in pair)
            found[name] = {"run": run, "jsbsim": jsbsim}
    return found
