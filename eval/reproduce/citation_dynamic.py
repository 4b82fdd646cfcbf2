"""Dynamic models of the Citation X paper on virtual flights: figures 10 to 21 and table 14.

At every identification flight a model is fitted to the response scaled to 0 .. 1; its parameters,
with the ratio at both ends, are interpolated over altitude and amplitude for the validation
flights. Steps and impulses are scaled as the ratio to the static model (eqs 21, 22), ramps as the
output itself, and taken for slow steps, as the paper does.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from eval.report import style
from eval.report.style import Picture, picture
from eval.reproduce.citation_static import (
    KINDS,
    MOVED,
    OUTPUTS,
    T_S,
    Disturbance,
    Kind,
    RegionStudy,
    chained,
    disturbances,
)
from narxcal.channels import symbol
from narxcal.state_space import Form, coordinates, from_coordinates
from narxcal.support.arrays import FloatArray
from narxcal.transfer import Schedule
from narxcal.turbofan import VirtualEngine
from training.papers.subspace import SubspaceSettings, subspace
from training.papers.transfer_fit import (
    ResponseKind,
    Scale,
    fit_response,
    rise_times,
    rise_times_agree,
    system_of,
)

# Numbers of the paper's figures of success and mean error.
FIGURES: dict[Kind, tuple[int, int]] = {"step": (16, 17), "impulse": (18, 19), "ramp": (20, 21)}
_SHOWN_S = {"impulse": 4.0, "ramp": 60.0}  # an impulse is over soon


def dynamic_pictures(study: DynamicStudy) -> list[Picture]:
    """Figures 10 to 15, as far as the flights were flown."""
    shown, found = study.shown, []
    if "step" in shown:
        found += [_step(shown["step"]), _rise(shown["step"]), _entries(study)]
    for number, kind in ((13, "impulse"), (14, "ramp")):
        if kind in shown:
            found.append(_disturbed(number, kind, shown[kind]))
    return found


def _ratios(flight: Scaled) -> dict[str, FloatArray]:
    """Output over its static value from the onset on, by output."""
    return {name: flight.flown[name] / flight.static[name] for name in OUTPUTS}


def _lines(axes: Axes, curves: dict[str, FloatArray], label: str) -> None:
    for colour, (name, values) in zip(style.CYCLE, curves.items(), strict=False):
        style.curve(axes, _times(len(values)), values, colour, lw=1.2, label=symbol(name))
    axes.set(xlabel="time from the onset [s]", ylabel=label)
    style.dress(axes)
    style.legend(axes, columns=5)


def _where(flight: Scaled) -> str:
    one = flight.flight
    return f"{one.altitude_ft:.0f} ft, amplitude {one.amplitude_deg:.0f}°"


def _step(flight: Scaled) -> Picture:
    drawn, left, right = style.pair(10.0, 2.9)
    _lines(left, _ratios(flight), "output / static value [-]")
    _lines(right, dict(zip(OUTPUTS, flight.y.T, strict=True)), "scaled ratio [-]")
    caption = f"Figures 10 and 11: ratios to the static model after a step, {_where(flight)}."
    return picture(drawn, "Ratios after a step, and scaled to 0 to 1", caption)


def _rise(flight: Scaled) -> Picture:
    y = flight.y[:, OUTPUTS.index("FN_kN")]
    drawn = style.figure(6.4, 2.6)
    axes = drawn.subplots()
    style.curve(axes, _times(len(y)), y, style.MODEL, lw=1.4)
    for level, at in zip((0.1, 0.9), rise_times(_times(len(y)), y), strict=True):
        axes.plot([0.0, at, at], [level, level, 0.0], color=style.BAD, lw=0.9, ls=":")
        axes.annotate(f"t{100 * level:.0f} = {at:.2f} s", (at, level), size=8, va="top")
    axes.set(xlabel="time from the onset [s]", ylabel="scaled thrust ratio [-]")
    style.dress(axes)
    caption = f"Figure 12: t10 and t90 of thrust, {_where(flight)}."
    return picture(drawn, "Times of 10 % and 90 % of the thrust response", caption)


def _disturbed(number: int, kind: Kind, flight: Scaled) -> Picture:
    figure, left, right = style.pair(10.0, 2.9)
    shown = slice(round(_SHOWN_S[kind] / T_S))
    plain = {name: flight.flown[name][shown] for name in OUTPUTS}
    _lines(left, {n: v / np.abs(v[0]) for n, v in plain.items()}, "output / first value [-]")
    _lines(right, {n: v[shown] for n, v in _ratios(flight).items()}, "output / static value [-]")
    caption = (
        f"Figure {number}: response to a {kind}, {_where(flight)}; right over the static model."
    )
    return picture(figure, f"Outputs after a {kind}, and their ratio to the static model", caption)


def _entries(study: DynamicStudy) -> Picture:
    """A_11 of the canonical form is the negative first coefficient of its polynomial."""
    figure, left, right = style.pair(10.0, 2.7)
    wanted = (("5/O O/5 (C = I)", "+".join(OUTPUTS), 1.0), ("1/O O/4 (canonical)", "FN_kN", -1.0))
    for axes, (model, group, sign) in zip((left, right), wanted, strict=True):
        values = sign * study.tables[model, group][..., 0]
        for k, colour in zip(range(values.shape[1]), style.CYCLE, strict=False):
            axes.plot(values[:, k], color=colour, marker="o", ms=3, label=f"amplitude {k + 1}")
        axes.set(xlabel="altitude of the mesh, by number", ylabel=f"A11, {model}")
        style.dress(axes)
        style.legend(axes, columns=4)
    caption = "Figure 15: first entry of A over altitude and amplitude, in two forms."
    return picture(figure, "First entry of the state matrix over altitude and amplitude", caption)


BLOCK_ROWS = 10
GROUPS: Mapping[str, tuple[tuple[str, ...], ...]] = {
    "1/O": tuple((name,) for name in OUTPUTS),
    "2/O": (("FPR", "EPR"), ("FN_kN", "FF_kgph"), ("EGT_C",)),
    "3/O": (("FPR", "EPR", "FN_kN"), ("EGT_C", "FF_kgph")),
    "5/O": (OUTPUTS,),
}
STATIC = "static model"


@dataclass(frozen=True)
class Candidate:
    """One dynamic model: fits y (time, outputs) to parameters (P,), and back."""

    name: str
    group: tuple[tuple[str, ...], ...]
    fit: Callable[[FloatArray], FloatArray] = field(repr=False)
    response: Callable[[FloatArray, int], FloatArray] = field(repr=False)


@dataclass(frozen=True, eq=False)
class Scaled:
    """Response of one flight from its onset: y (time, outputs) and how it was scaled."""

    flight: Disturbance
    static: Mapping[str, FloatArray]
    scales: Mapping[str, Scale]
    y: FloatArray

    @classmethod
    def of(cls, study: RegionStudy, flight: Disturbance) -> Scaled:
        """Scale one flight by the static model of its region."""
        whole = chained(study.chain, flight.columns)
        static = {name: values[MOVED:] for name, values in whole.items()}
        scales, y = {}, []
        for name in OUTPUTS:
            values = flight.columns[name][MOVED:]
            ratio = values if flight.kind == "ramp" else values / static[name]
            scales[name] = Scale.of(ratio, name=f"{name} of the {flight.kind}")
            y.append(scales[name].scaled(ratio))
        return cls(flight, static, scales, np.column_stack(y))

    @property
    def flown(self) -> dict[str, FloatArray]:
        """Outputs (time,) as they were."""
        return {name: self.flight.columns[name][MOVED:] for name in OUTPUTS}

    def output(self, name: str, y: FloatArray, ends: FloatArray) -> FloatArray:
        """Output (time,) of a scaled response between the ratios (or values) `ends`."""
        scaled = Scale(*ends).ratio(y)
        return scaled if self.flight.kind == "ramp" else scaled * self.static[name]

    def errors_pct(self, name: str, predicted: FloatArray) -> FloatArray:
        """Relative error (time,); at most 1e6 %, so that a divergence has a mean."""
        measured = self.flown[name]
        with np.errstate(over="ignore", invalid="ignore"):
            error = np.abs(predicted - measured) / np.abs(measured)
        return 100.0 * np.minimum(np.nan_to_num(error, nan=1e4), 1e4)


def grey_boxes(kind: Kind) -> list[Candidate]:
    """First and second order; the impulse has no delayed one (the paper: too fast)."""
    single = GROUPS["1/O"]
    names: dict[ResponseKind, str] = {
        "first": "order 1",
        "first t90": "order 1 (t90)",
        "delayed": "order 1 delayed",
        "second": "order 2",
    }
    return [
        Candidate(name, single, partial(_grey_fit, law), partial(_grey_response, law))
        for law, name in names.items()
        if not (kind == "impulse" and law == "delayed")
    ]


def black_boxes() -> list[Candidate]:
    """State space by group of outputs and order, in modal and canonical form, and with C = I."""
    pairs = [("1/O", 1), ("1/O", 2), ("1/O", 3), ("1/O", 4), ("2/O", 2), ("2/O", 3), ("3/O", 3),
             ("5/O", 2), ("5/O", 5)]  # fmt: skip
    found = [_black_box(outputs, order, "modal") for outputs, order in pairs]
    return [
        *found, _black_box("1/O", 4, "canonical"), _black_box("5/O", 5, "output"),
    ]  # fmt: skip


@dataclass(frozen=True, eq=False)
class DynamicStudy:
    """Rows of all models in one region, and of the steps the flights and the parameter tables.

    A row is of a model and an output over the validation flights: mean and largest error of a
    sample, success, and success at the identification flights, without interpolation. A table
    (altitude, amplitude, P) belongs to a model and a group of outputs; `shown` is the last
    identification flight of each kind, at the highest altitude and largest amplitude.
    """

    rows: pd.DataFrame
    steps: list[Scaled]
    tables: dict[tuple[str, str], FloatArray]
    shown: dict[Kind, Scaled]


_COLUMNS = ("kind", "model", "output", "mean_pct", "worst_pct", "success_pct", "identified_pct")


def dynamic_study(
    study: RegionStudy, engine: VirtualEngine, kinds: Sequence[Kind] = KINDS
) -> DynamicStudy:
    """Fit every dynamic model to disturbances of each kind and score it on others."""
    rows: list[tuple[object, ...]] = []
    found = DynamicStudy(pd.DataFrame(), [], {}, {})
    for kind in kinds:
        known, new = (
            [Scaled.of(study, flight) for flight in disturbances(engine, study.region, role, kind)]
            for role in ("identification", "validation")
        )
        rows += _static_rows(kind, new)
        found.shown[kind] = known[-1]
        found.steps.extend(known if kind == "step" else [])
        for candidate in [*grey_boxes(kind), *black_boxes()]:
            for group in candidate.group:
                own, table = _group_rows(study, candidate, group, (known, new))
                rows += own
                if kind == "step":
                    found.tables[candidate.name, "+".join(group)] = table
    return replace(found, rows=pd.DataFrame(rows, columns=[*_COLUMNS, "flights"]))


def merged(rows: pd.DataFrame) -> pd.DataFrame:
    """Rows of several regions pooled by kind, model and output, weighted by flights."""
    means = ["mean_pct", "success_pct", "identified_pct"]
    weighted = rows.assign(**{name: rows[name] * rows["flights"] for name in means})
    groups = weighted.groupby(["kind", "model", "output"], sort=False)
    found = groups[[*means, "flights"]].sum(min_count=1)
    found[means] = found[means].div(found["flights"], axis=0)
    return found.join(groups["worst_pct"].max()).reset_index()[list(rows)]


def _static_rows(kind: Kind, new: Sequence[Scaled]) -> list[tuple[object, ...]]:
    rows: list[tuple[object, ...]] = []
    for name in OUTPUTS:
        errors = np.array([one.errors_pct(name, one.static[name]) for one in new])
        rows.append((kind, STATIC, name, errors.mean(), errors.max(), np.nan, np.nan, len(new)))
    return rows


def _group_rows(
    study: RegionStudy,
    candidate: Candidate,
    group: tuple[str, ...],
    flights: tuple[Sequence[Scaled], Sequence[Scaled]],
) -> tuple[list[tuple[object, ...]], FloatArray]:
    """Fit at every identification flight, interpolate at the validation flights, score."""
    known, new = flights
    at, count = [OUTPUTS.index(name) for name in group], len(known[0].y)
    axes = study.region.conditions("identification")
    fitted = np.array([candidate.fit(s.y[:, at]) for s in known])
    ends = np.array([[(s.scales[n].start, s.scales[n].end) for n in group] for s in known])
    schedule, limits = (
        Schedule(axes, values.reshape(*map(len, axes), -1)) for values in (fitted, ends)
    )
    identified = [_agree(candidate.response(p, count), s.y[:, at])
                  for p, s in zip(fitted, known, strict=True)]  # fmt: skip
    errors, agreed = [], []
    for s in new:
        condition = s.flight.altitude_ft, s.flight.amplitude_deg
        with np.errstate(over="ignore", invalid="ignore"):
            y = candidate.response(schedule.at(condition), count)
        edges = limits.at(condition).reshape(-1, 2)
        errors.append([
            s.errors_pct(name, s.output(name, y[:, k], edges[k])) for k, name in enumerate(group)
        ])  # fmt: skip
        agreed.append(_agree(y, s.y[:, at]))
    cube, kind = np.array(errors), known[0].flight.kind
    success, first = (100.0 * np.mean(each, axis=0) for each in (agreed, identified))
    columns = zip(group, cube.mean(axis=(0, 2)), cube.max(axis=(0, 2)), success, first, strict=True)
    return [(kind, candidate.name, *values, len(new)) for values in columns], schedule.values  # noqa: PD011 -- no data frame


def _agree(model: FloatArray, data: FloatArray) -> list[bool]:
    """Whether t10 and t90 agree, output by output."""
    t = _times(len(data))
    return [rise_times_agree(t, y, z) for y, z in zip(model.T, data.T, strict=True)]


def _times(count: int) -> FloatArray:
    return T_S * np.arange(count, dtype=np.float64)


def _grey_fit(law: ResponseKind, y: FloatArray) -> FloatArray:
    found = fit_response(_times(len(y)), y[:, 0], law).values  # noqa: PD011 -- no data frame
    return np.log(found) if law != "delayed" else np.array([np.log(found[0]), found[1]])


def _grey_response(law: ResponseKind, values: FloatArray, count: int) -> FloatArray:
    found = np.exp(values) if law != "delayed" else np.array([np.exp(values[0]), values[1]])
    return system_of(law, found).step(_times(count))[:, np.newaxis]


def _black_box(outputs: str, order: int, form: Form) -> Candidate:
    suffix = {"modal": "", "canonical": " (canonical)", "output": " (C = I)"}[form]
    return Candidate(
        f"{outputs} O/{order}{suffix}",
        GROUPS[outputs],
        partial(_black_fit, order, form),
        partial(_black_response, order, form),
    )


def _black_fit(order: int, form: Form, y: FloatArray) -> FloatArray:
    """Subspace fit to a unit step after 2 s quiet samples; the sizes follow the coordinates."""
    quiet = np.zeros((2 * BLOCK_ROWS, y.shape[1]))
    u = np.concatenate([quiet[:, :1], np.ones((len(y), 1))])
    settings = SubspaceSettings(dt_s=T_S, polish=False)
    fitted = subspace([(u, np.concatenate([quiet, y]))], order, BLOCK_ROWS, settings)
    return np.concatenate([coordinates(fitted.model, form), [y.shape[1]]])


def _black_response(order: int, form: Form, values: FloatArray, count: int) -> FloatArray:
    outputs = round(values[-1])
    model = from_coordinates(values[:-1], (order, outputs, 1), T_S, form)
    return model.simulate(np.ones((count, 1)))
