"""A model as an ONNX graph: (state, input) -> (next state, output), in float64.

    state   (batch, states): as `x` of the C, part by part; NaN begins a run in equilibrium
    input   (batch, n_in),  output (batch, n_out)

The equations of the lags are those of `narxcal.lumped`, traced; the other parts are a page each of
the C, with the same tables of numbers (`narxcal.export.parts`).
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from narxcal.atmosphere import KELVIN, T0_K
from narxcal.export.onnx_graph import Graph, Number, clip, traced, where
from narxcal.export.parts import LAG_ROWS, Struct
from narxcal.export.program import Program
from narxcal.lumped import governed, limited
from narxcal.lumped.states import Drive, Engine
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ModelError
from narxcal.support.files import atomic_write_bytes

Numbers = list[Any]  # columns (batch,), one per channel


class _Sample:
    """Inputs and steady state of a sample, as columns."""

    def __init__(self, model: _Model, given: Numbers) -> None:
        self.given = given
        self.ss: Numbers = model.steady(given)


def _air(g: Graph, given: Numbers, columns: Sequence[int]) -> tuple[Any, Any]:
    """theta2 and delta2 of columns of altitude, Mach and temperature deviation."""
    alt, mach, hot = (given[k] if k >= 0 else g.constant(0.0) for k in columns)
    height = clip(alt * 0.3048, -np.inf, 20e3)
    standard = T0_K - 0.0065 * clip(height, -np.inf, 11e3)
    above = clip(height - 11e3, 0.0, np.inf)
    pressure = (standard / T0_K).to("Pow", 9.80665 / (287.05287 * 0.0065))
    pressure *= (above * (-9.80665 / (287.05287 * (T0_K - 0.0065 * 11e3)))).to("Exp")
    rise = 1.0 + 0.2 * (mach * mach)
    return (standard + hot) / T0_K * rise, pressure * rise.to("Pow", 3.5)


class _Model:
    """The graph while it is built."""

    def __init__(self, program: Program) -> None:
        self.graph, self.program = Graph(), program
        self.struct = program.steady_struct
        self.outputs = len(program.model.output_names)

    def steady(self, given: Numbers) -> Numbers:
        """Steady state at columns of inputs."""
        n = self.struct.numbers
        if self.struct.kind == "table":
            parts = [self._grid(one, given) for one in n["grids"]]
            return [sum(columns[1:], columns[0]) for columns in zip(*parts, strict=True)]
        return self._fitted(n, given)

    def _scale(self, kind: int, air: tuple[Any, Any]) -> Any:
        theta, delta = air
        root = theta.to("Sqrt")
        return [1.0, root, theta, delta * root, delta][kind]

    def _fitted(self, n: Any, given: Numbers) -> Numbers:
        g, air, z = self.graph, _air(self.graph, given, n["air"]), given[n["driver"]]
        if n["fuel"] >= 0:
            z = clip(z / self._scale(n["fuel"], air), 1.0, np.inf).to("Log")
        knot = n["knot"]
        z = clip(z, knot[0], knot[-1])
        piece = self._cell(knot, z)
        s = z - g.constant(knot).to("Gather", piece)
        x = (z - knot[0]) / (knot[-1] - knot[0]) - 0.5
        weights: Numbers = [1.0]
        for b in n["blend"]:
            low, width = n["low"][b], max(n["high"][b] - n["low"][b], 1e-12)
            share = clip((given[b] - low) / width, 0.0, 1.0)
            weights = [each for w in weights for each in (w * (1.0 - share), w * share)]
        flat = n["curve"][0].reshape(len(knot) - 1, -1)
        row = g.constant(flat).to("Gather", piece)
        ratios = []
        for k, which in enumerate(n["ratio"]):
            low, high = n["ratio_seen"][k]
            ratios.append(clip(air[which].to("Log"), low, high) - 0.5 * (low + high))
        found = []
        for o in range(self.outputs):
            y: Any = 0.0
            for v, weight in enumerate(weights):
                at = 3 * (o * len(weights) + v)
                c = [row.column(at + k) for k in range(3)]
                y += weight * (c[0] + (c[1] + c[2] * s) * s)
            factors = [*(given[k] for k in n["switch_column"]), *ratios]
            for factor, one in zip(factors, [*n["switch_line"], *n["ratio_line"]], strict=True):
                y += factor * (one[o][0] + one[o][1] * x)
            kind = n["kinds"][o]
            y *= self._scale(kind, air)
            found.append(y - KELVIN if kind == 2 else y)  # a temperature
        return found

    def _cell(self, nodes: FloatArray, x: Number) -> Number:
        """The cell of rising nodes in which a column lies, as integers."""
        g, inner = self.graph, nodes[1:-1]
        if not len(inner):
            return (x * 0.0).to("Cast", to=7)
        over = x.to("Unsqueeze", g.constant([1], np.int64)).to("GreaterOrEqual", inner)
        counted = over.to("Cast", to=11).to("ReduceSum", g.constant([1], np.int64), keepdims=0)
        return counted.to("Cast", to=7)

    def _grid(self, struct: Struct, given: Numbers) -> Numbers:
        """Multilinear interpolation: all corners of the cell at once."""
        g, n = self.graph, struct.numbers
        ends = np.cumsum([0, *n["lengths"]])
        row, weights = g.constant([[0]], np.int64), g.constant([[1.0]])
        one, stride = g.constant([1], np.int64), int(np.prod(n["lengths"], dtype=np.int64))
        for d, column in enumerate(n["columns"]):
            axis = n["nodes"][ends[d] : ends[d + 1]]
            stride //= len(axis)
            if len(axis) == 1:
                continue
            x = clip(given[column], axis[0], axis[-1])
            cell = self._cell(axis, x)
            low = g.constant(axis[:-1]).to("Gather", cell)
            share = ((x - low) / g.constant(np.diff(axis)).to("Gather", cell)).to("Unsqueeze", one)
            first = row.to("Add", cell.to("Mul", g.constant(stride, np.int64)).to("Unsqueeze", one))
            row = g.add("Concat", first, first.to("Add", g.constant(stride, np.int64)), axis=1)
            weights = g.add("Concat", weights * (1.0 - share), weights * share, axis=1)
        table = n["values"].reshape(-1, n["width"])
        exact = np.array_equal(table.astype(np.float32), table)  # as rounded ones are
        values = g.constant(table, np.float32 if exact else np.float64).to("Gather", row)
        values = values.to("Cast", to=11) if exact else values
        weighted = values * weights.to("Unsqueeze", g.constant([2], np.int64))
        found = weighted.to("ReduceSum", one, keepdims=0)
        return [found.column(o) for o in range(n["width"])]

    # ---- parts: the state at a first sample, and deviations and state at the next one

    def lags_start(self, n: Any, now: _Sample) -> Numbers:
        at = self._drive(n, now)
        return [*[0.0] * ((LAG_ROWS - 2) * self.outputs), *at.target[0], *now.ss]

    def lags_step(self, lags: Struct, now: _Sample, x: Numbers) -> tuple[Numbers, Numbers]:
        n, own, form = lags.numbers, self.outputs, lags.needs[-1]
        at = self._drive(n, now)
        table = np.array(x, dtype=object).reshape(LAG_ROWS, own)
        states, before = table[: LAG_ROWS - 2].copy(), table[LAG_ROWS - 2 :]
        drive = Drive(
            np.array([before[1], at.ss[0]]), np.array([before[0], at.target[0]]),
            np.array([at.per_unit[0]] * 2), np.array([at.air[0]] * 2),
        )  # fmt: skip
        engine = Engine(n["theta"], n["limit"], n["order"], n["own"], n["rank"], form == "governed")
        names = traced(governed if form == "governed" else limited)
        names[form](engine, drive, states, 1, n["dt_s"])
        deviation = [states[:3, o].sum() for o in range(own)]
        return deviation, [*states.ravel(), *at.target[0], *now.ss]

    def _drive(self, n: Any, now: _Sample) -> Drive:
        theta, delta = _air(self.graph, now.given, n["air"])
        root = theta.to("Sqrt")
        target = [
            (y / root - c) / h for y, c, h in zip(now.ss, n["centre"], n["half"], strict=True)
        ]
        unit = [1.0 / (root * h) for h in n["half"]]
        mach = now.given[n["air"][1]] if n["air"][1] >= 0 else 0.0
        air = [(root / delta).to("Log"), root.to("Log"), mach]
        return Drive(*(np.array([one], dtype=object) for one in (now.ss, target, unit, air)))

    def _features(self, n: Any, now: _Sample, was: Numbers, lagged: Numbers) -> Numbers:
        moved = [y - old for y, old in zip(now.ss, was, strict=True)]
        row = [*moved, *lagged, *now.ss, *(now.given[k] for k in n["schedule"])]
        return [(v - c) / s for v, c, s in zip(row, n["in_centre"], n["in_scale"], strict=True)]

    def narx_start(self, n: Any, now: _Sample) -> Numbers:
        own, zeros = self.outputs, [0.0] * self.outputs
        history = [-c / s for c, s in zip(n["out_centre"], n["out_scale"], strict=True)]
        row = self._features(n, now, now.ss, zeros if "lag" in n else [])
        lags = self.lags_start(n["lag"].numbers, now) if "lag" in n else []
        return [*now.ss, *[0.0] * (2 * own), *history * n["lags"], *row * (n["depth"] + 1), *lags]

    def narx_step(self, n: Any, now: _Sample, x: Numbers) -> tuple[Numbers, Numbers]:
        own, width, depth = self.outputs, n["width"], n["depth"]
        ss, error, bound = x[:own], x[own : 2 * own], x[2 * own : 3 * own]
        past = 3 * own + n["lags"] * own
        history, last = x[3 * own : past], past + (depth + 1) * width
        lagged, behind = [0.0] * own, x[last:]
        if "lag" in n:
            lagged, behind = self.lags_step(n["lag"], now, x[last:])
        new = self._features(n, now, ss, lagged if "lag" in n else [])
        rows = [*x[past + width : last], *new]
        d, kept = [], []
        for o, y in enumerate(self._network(n, history, rows)):
            found = clip(y, n["low"][o], n["high"][o])
            if n["keep"] >= 0.0:
                error[o] = n["keep"] * (error[o] + now.ss[o] - ss[o])
                bound[o] = abs(error[o]).to("Max", n["keep"] * bound[o])
                limit = 2.0 * bound[o] / n["out_scale"][o]
                found = found.to("Max", -limit).to("Min", limit)
            kept.append(found)
            share = n["share"][o]
            d.append(share * (found * n["out_scale"][o] + n["out_centre"][o]) + lagged[o])
        history = [*kept, *history[: len(history) - own]]
        return d, [*now.ss, *error, *bound, *history, *rows, *behind]

    def _network(self, n: Any, history: Numbers, rows: Numbers) -> Numbers:
        width, anchored = n["width"], n["moving"] > 0
        tapped = [v for t in n["tap"] for v in rows[(n["depth"] - t) * width :][:width]]
        phi = self.joined([*history, *tapped])
        m = len(history)
        shown = np.ones(m + len(tapped))
        if anchored:
            shown[m:] = np.tile(np.arange(width) < n["moving"], len(n["tap"]))
        linear = phi.to("MatMul", (n["a"] * shown).T)
        active = (phi.to("MatMul", n["w1"].T) + n["b1"]).to("Tanh")
        if anchored:
            active -= (phi.to("MatMul", (n["w1"] * (1.0 - shown)).T) + n["b1"]).to("Tanh")
        else:
            linear += n["b2"]
        found = linear + active.to("MatMul", n["w2"].T)
        return [found.column(o) for o in range(self.outputs)]

    def member_start(self, n: Any, now: _Sample) -> Numbers:
        order = max(n["order"], 1)
        return [*[now.ss[n["channel"]]] * order, *now.ss * order]

    def member_step(self, n: Any, now: _Sample, x: Numbers) -> tuple[Numbers, Numbers]:
        own, order, ss = self.outputs, n["order"], now.ss[n["channel"]]
        if order == 0:
            ahead = ss - x[0]
            y, kept = x[0] + where(ahead > 0.0, n["push"] * ahead, n["pull"] * ahead), x[1:]
        else:
            drive = [*now.ss, *x[order:]]
            y = n["offset"]
            for k, gain in enumerate(n["gains"].ravel()):
                y += gain * drive[k]
            for k, pole in enumerate(n["poles"]):
                y += pole * x[k]
            kept = [*x[: order - 1], *drive[: order * own]]
        d: Numbers = [self.graph.constant(0.0)] * own
        d[n["channel"]] = ss - y
        return d, [y, *kept]

    def state_space_start(self, n: Any, now: _Sample) -> Numbers:
        return [*[0.0] * (n["order"] + self.outputs), *now.ss]

    def state_space_step(self, n: Any, now: _Sample, x: Numbers) -> tuple[Numbers, Numbers]:
        order, own = n["order"], self.outputs
        moved = self.joined([y - old for y, old in zip(now.ss, x[order + own :], strict=True)])
        state = moved.to("MatMul", n["B"].T)
        state += self.joined(x[:order]).to("MatMul", n["A"].T)
        added = [n["fade"] * one for one in x[order : order + own]]
        shown = state.to("MatMul", n["C"].T)
        d = [shown.column(o) - added[o] for o in range(own)]
        return d, [*(state.column(k) for k in range(order)), *added, *now.ss]

    def _lagged(self, y: Any, ends: tuple[Any, Any], samples: Any) -> Any:
        behind = samples * (ends[1] - ends[0])
        return ends[1] - behind + (y - ends[0] + behind) * (-1.0 / samples).to("Exp")

    def _conditions(self, n: Any, now: _Sample, o: int) -> Numbers:
        at = [*([now.ss[o]] if n["level"] else []), *(now.given[k] for k in n["columns"])]
        logs = self._grid(n["schedules"][o], at)
        return [*logs, *[0.0] * (2 - len(logs))]

    def response_start(self, n: Any, now: _Sample) -> Numbers:
        return [
            value
            for o, ss in enumerate(now.ss)
            for value in (ss, ss, 0.0, *self._conditions(n, now, o))
        ]

    def response_step(self, n: Any, now: _Sample, x: Numbers) -> tuple[Numbers, Numbers]:
        d, kept, h = [], [], n["dt_s"]
        for o, u in enumerate(now.ss):
            was, y, v, first, second = x[5 * o : 5 * o + 5]
            if n["schedules"][o].numbers["width"] == 1:
                y = self._lagged(y, (was, u), first.to("Exp") / h)
            else:
                y, v = _second_order((was, u), (first.to("Exp"), second.to("Exp")), h, (y, v))
            d.append(u - y)
            kept += [u, y, v, *self._conditions(n, now, o)]
        return d, kept

    def _engine_drive(self, n: Any, now: _Sample) -> Numbers:
        order, k, step = n["order"], n["driver"], 0.01 * (n["high"] - n["low"])
        ends = []
        for sign in (step, -step):
            moved = list(now.given)
            moved[k] = clip(now.given[k] + sign, n["low"], n["high"])
            ends.append(self.steady(moved))
        rise = [ends[0][o] - ends[1][o] for o in order]
        moves = abs(rise[0]) > 1e-6
        safe = where(moves, rise[0], self.graph.constant(1.0))
        slopes = [where(moves, r / safe, self.graph.constant(0.0)) for r in rise[1:]]
        return [*(now.ss[o] for o in order), *slopes]

    def output_error_start(self, n: Any, now: _Sample) -> Numbers:
        return [*(now.ss[o] for o in n["order"]), *self._engine_drive(n, now)]

    def output_error_step(self, n: Any, now: _Sample, x: Numbers) -> tuple[Numbers, Numbers]:
        u, old = self._engine_drive(n, now), x[3:]
        ahead = [n["tau_M"] * (u[k] - old[k]) for k in range(3)]
        was, goal = [old[k] + ahead[k] for k in range(3)], [u[k] + ahead[k] for k in range(3)]
        behind, above = x[0] - was[0], x[0] - n["reference"]
        slow = n["tau_H"] * (-n["rate_H"] * above).to("Exp")
        y = [self._lagged(x[0], (was[0], goal[0]), slow)]
        left = y[0] - goal[0]
        times = n["tau_L"] * (-n["rate_L"] * above).to("Exp"), self.graph.constant(n["tau_T"])
        for k, by in ((1, 1.0 - n["alpha"]), (2, 1.0 - n["beta"])):
            ends = was[k] + by * old[2 + k] * behind, goal[k] + by * u[2 + k] * left
            y.append(self._lagged(x[k], ends, times[k - 1]))
        d: Numbers = [0.0] * self.outputs
        for k, o in enumerate(n["order"]):
            d[o] = now.ss[o] - y[k]
        return d, [*y, *u]

    def joined(self, columns: Numbers) -> Number:
        """Columns as rows (batch, n)."""
        g, one = self.graph, self.graph.constant([1], np.int64)
        whole = self.batch
        return g.add("Concat", *((whole + v).to("Unsqueeze", one) for v in columns), axis=1)

    def build(self) -> tuple[Number, Number]:
        g, given = self.graph, Number(self.graph, "input")
        inputs: Numbers = [given.column(k) for k in range(len(self.program.model.input_names))]
        self.batch = inputs[0] * 0.0
        reach = self.program.model.reach
        if reach is not None:
            inputs = [clip(v, reach.low[k], reach.high[k]) for k, v in enumerate(inputs)]
        state, at = Number(g, "state"), 0
        begins = state.column(0).to("IsNaN")
        inputs, late = self._delayed(inputs, state, begins)
        now = _Sample(self, inputs)
        total, kept = [self.batch] * self.outputs, []
        for part in self.program.parts:
            x = [state.column(at + k) for k in range(part.states)]
            start, step = (getattr(self, f"{part.struct.kind}_{v}") for v in ("start", "step"))
            begun = start(part.struct.numbers, now)
            d, after = step(part.struct.numbers, now, x)
            kept += [where(begins, a, b) for a, b in zip(begun, after, strict=True)]
            for o, weight in enumerate(part.weights):
                if weight:
                    total[o] += weight * d[o]
            at += part.states
        outputs = [
            ss - where(begins, g.constant(0.0), t) for ss, t in zip(now.ss, total, strict=True)
        ]
        return self.joined([*kept, *late] or [self.batch]), self.joined(outputs)

    def _delayed(self, inputs: Numbers, state: Number, begins: Number) -> tuple[Numbers, Numbers]:
        """Inputs as they act, and the rows of those that act late."""
        rows, part, columns = self.program.delay
        if not rows:
            return inputs, []
        first = self.program.states - rows * len(columns)
        past = [state.column(first + k) for k in range(rows * len(columns))]
        newest, acting = [inputs[c] for c in columns], list(inputs)
        past = [where(begins, newest[k % len(columns)], one) for k, one in enumerate(past)]
        after = [*past[len(columns) :], *newest]
        for k, column in enumerate(columns):
            acting[column] = (1.0 - part) * after[k] + part * past[k]
        return acting, after


def _second_order(
    u: tuple[Any, Any], natural: tuple[Any, Any], h: float, state: tuple[Any, Any]
) -> tuple[Any, Any]:
    (was, now), (xi, w), (y, v) = u, natural, state
    decay, square = xi * w, w * w * (xi * xi - 1.0) * (h * h)
    root = abs(square).to("Max", 1e-8).to("Sqrt")
    up, down = root.to("Exp"), (-root).to("Exp")
    damped, swings = square > 1e-8, square < -1e-8
    even = where(damped, 0.5 * (up + down), where(swings, root.to("Cos"), 1.0 + 0.5 * square))
    swing = where(swings, root.to("Sin") / root, 1.0 + square / 6.0)
    odd = h * where(damped, 0.5 * (up - down) / root, swing)
    fall = (-decay * h).to("Exp")
    even, odd = fall * even, fall * odd
    rate = (now - was) / h
    behind = 2.0 * xi / w * rate
    e, r = y - was + behind, v - rate
    return (
        now - behind + (even + decay * odd) * e + odd * r,
        rate - w * w * odd * e + (even - decay * odd) * r,
    )


def write_onnx(program: Program, file: Path) -> int:
    """Write the model of the chosen engine; returns the size in bytes."""
    if find_spec("onnx") is None:
        raise ModelError("ONNX is not installed", hint="pip install 'narxcal[export]'")
    model, states = _Model(program), max(program.states, 1)
    state, output = model.build()
    data = model.graph.serialized(
        {"state": states, "input": len(program.model.input_names)},
        {"next_state": (state, states), "output": (output, model.outputs)},
        {
            "about": "; ".join(program.about),
            "run_sha256": program.sha256,
            "dt_s": repr(program.model.dt_s),
            "inputs": ",".join(program.model.input_names),
            "outputs": ",".join(program.model.output_names),
            "state": "NaN begins a run in equilibrium at the input; then pass next_state on",
        },
    )
    atomic_write_bytes(file, data)
    return len(data)
