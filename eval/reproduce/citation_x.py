"""The Citation X paper on virtual flights: its tables and figures, and its claims, in two studies.

Every number comes from the virtual engine: models are compared with an engine model, as the paper
compares them with a simulator, and an error of 1 % says nothing about an engine.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import product

import numpy as np
import pandas as pd

from eval.report.tables import Table
from eval.reproduce.citation_dynamic import (
    FIGURES,
    GROUPS,
    STATIC,
    DynamicStudy,
    Scaled,
    dynamic_pictures,
    dynamic_study,
    merged,
)
from eval.reproduce.citation_static import (
    BEST_THRUST,
    KINDS,
    OUTPUTS,
    PRESSURES,
    REGIONS,
    T_S,
    Engines,
    Kind,
    Region,
    RegionStudy,
    static_study,
)
from eval.reproduce.study import CLAIMS, Claim, Study, claim, table_of
from narxcal.atmosphere import air_state
from narxcal.static_models.model import CP, GAS_R, K
from narxcal.support.arrays import FloatArray
from narxcal.support.progress import Progress, silent
from training.papers.transfer_fit import rise_times
from training.steady.static_fit import SEARCHES, Estimator

_THRUST = ("Mattingly", "Torenbeek", "Aerospatiale", "Wanner")
_FUEL = ("Torenbeek fuel", "BADA 3", "Yoder")
_BOX = "polynomial 2"  # the black box that thrust and fuel are compared with
_FIRST, _DELAYED, _SECOND = "order 1", "order 1 delayed", "order 2"
_ONE, _WIDE = "1/O O/3", "5/O O/5 (C = I)"
CONTRADICTIONS: tuple[str, ...] = tuple(CLAIMS["contradictions"]["citation-x"])
_claim = partial(claim, "citation-x")
Tables = Mapping[tuple[str, str], FloatArray]
ByModel = Mapping[tuple[str, str], pd.DataFrame]  # (kind, model) -> rows by output


def static_claims(engines: Engines, low: RegionStudy, high: RegionStudy) -> list[Claim]:
    """C1 to C8 and C14."""
    share = 100.0 * abs(cold_share(engines, high) - 0.75)
    return [
        *_thrust_and_fuel(high), *_regions(low, high), *_degrees(low), *_degrees(high),
        _claim("C14", share),
    ]  # fmt: skip


def dynamic_claims(
    rows: pd.DataFrame, steps: Sequence[Scaled], tables: Sequence[Tables]
) -> list[Claim]:
    """C9 to C13 and C15; `rows` pooled over the regions, `steps` the identification flights."""
    kinds = rows["kind"].unique()
    table = {
        (str(kind), str(model)): own.set_index("output")
        for (kind, model), own in rows.groupby(["kind", "model"])
    }
    found = [*_starts(steps), *_steps(rows, table), *_orders(table, tables)]
    if len(kinds) == len(KINDS):
        found += [*_impulses_and_ramps(table)]
    for kind in kinds:
        ratio = _all(table, kind, _FIRST) / _all(table, kind, STATIC)
        found.append(_claim("C15", float(ratio.max()), kind=kind))
    return found


def _thrust_and_fuel(high: RegionStudy) -> Iterator[Claim]:
    thrust, fuel = _mean(high, "FN_kN", BEST_THRUST), _mean(high, "FF_kgph", "Yoder+")
    laws = [_mean(high, "FN_kN", f"{law}{drag}") for law in _THRUST for drag in ("", " - drag")]
    fuels = [_mean(high, "FF_kgph", name) for name in _FUEL]
    yield _claim("C1_error", thrust)
    yield _claim("C1_success", _success(high, BEST_THRUST))
    yield _claim("C1_best", thrust / np.nanmin(laws))
    yield _claim("C2_error", fuel)
    yield _claim("C2_success", _success(high, "Yoder+", "FF_kgph"))
    yield _claim("C2_best", fuel / np.nanmin(fuels))
    for name in ("Cold Thrust", "Yoder+"):
        ratio = _search(high, name, "swarm") / _search(high, name, "levenberg-marquardt")
        yield _claim("C3", ratio, name=name)
    least = float(np.nanmin([_success(high, f"{law} - drag") for law in _THRUST]))
    yield _claim("C4_laws", least)
    yield _claim("C4_box", _success(high, _BOX))
    for name, grey in (("FN_kN", thrust), ("FF_kgph", fuel)):
        yield _claim("C8", grey / _mean(high, name, _BOX), name=name)


def _regions(low: RegionStudy, high: RegionStudy) -> Iterator[Claim]:
    for name in OUTPUTS:
        kind = {"FN_kN": BEST_THRUST, "FF_kgph": "Yoder+"}.get(name, "spline table")
        yield _claim("C5", _mean(low, name, kind) / _mean(high, name, kind), name=name)
    for name in PRESSURES:
        spline, box = (
            sum(_mean(study, name, model) for study in (low, high))
            for model in ("spline table", "polynomial 3")
        )
        yield _claim("C6", spline / box, name=name)


def _degrees(study: RegionStudy) -> Iterator[Claim]:
    degrees, known, left_out, _ = np.array(study.degrees).T
    name, best = study.region.name, int(degrees[np.argmin(left_out)])
    yield _claim("C7_known", float(np.max(known[1:] / known[:-1])), name=name)
    yield _claim("C7_best", float(left_out[-1] / left_out.min()), name=name, best=best)


def _starts(steps: Sequence[Scaled]) -> Iterator[Claim]:
    start = {n: float(np.median([s.scales[n].start for s in steps])) for n in OUTPUTS}
    yield _claim("C9_FPR", start["FPR"])
    for name in OUTPUTS[1:]:
        yield _claim("C9_start", start[name], name=name)
    yield _claim("C9_thrust", _latest(steps, "FN_kN", _early))
    yield _claim("C9_ITT", _latest(steps, "EGT_C", _settling))
    yield _claim("C9_fuel", float(np.median([s.scales["FF_kgph"].end for s in steps])))


def _steps(rows: pd.DataFrame, table: ByModel) -> Iterator[Claim]:
    grey = (_FIRST, _DELAYED, _SECOND)
    own = rows[(rows["kind"] == "step") & rows["model"].isin(grey)]
    yield _claim("C10_known", own["identified_pct"].min())
    best = np.argmin([_all(table, "step", m) for m in grey], axis=0)
    yield _claim("C10_delayed", float(np.sum(best[:-1] == 1)))
    success = {m: _all(table, "step", m, "success_pct").mean() for m in (*grey, _ONE)}
    yield _claim("C10_first", success[_FIRST] - success[_DELAYED])
    yield _claim("C10_box", success[_ONE] - max(success[m] for m in grey))


def _impulses_and_ramps(table: ByModel) -> Iterator[Claim]:
    first, second, many, three = (_all(table, "impulse", m) for m in (_FIRST, _SECOND, _WIDE, _ONE))
    yield _claim("C11_second", first.mean() / second.mean())
    yield _claim("C11_box", first.mean() / three.mean())
    others = {kind: _all(table, kind, _WIDE).max() for kind in ("step", "ramp")}
    yield _claim("C11_most", float(many.max()), **others)
    ramp, step = _all(table, "ramp", _DELAYED), _all(table, "step", _DELAYED)
    yield _claim("C12_ramp", ramp.mean() / step.mean())
    ratios = ramp / _all(table, "ramp", _SECOND)
    yield _claim("C12_second", float(ratios[:-1].mean()))
    yield _claim("C12_fuel", float(ratios[-1]))
    yield _claim("C12_static", _all(table, "ramp", STATIC, "worst_pct").max())


def _orders(table: ByModel, tables: Sequence[Tables]) -> Iterator[Claim]:
    one, modal, free = (_all(table, "step", m).mean() for m in (_FIRST, "5/O O/5", _WIDE))
    yield _claim("C13_free", one / free)
    yield _claim("C13_modal", one / modal, one=one, modal=modal, free=free)
    pair = (_WIDE, "+".join(OUTPUTS)), ("1/O O/4 (canonical)", "FN_kN")
    entries = [[t[key][..., 0] for key in pair] for t in tables]
    wide, narrow = np.mean([[np.std(a) / abs(np.mean(a)) for a in each] for each in entries], 0)
    yield _claim("C13_A11", float(wide / narrow))


def cold_share(engines: Engines, study: RegionStudy) -> float:
    """Mean share of the fan stream in net thrust, from the stations of the designed engine."""
    rows, engine = study.validation, engines.designed
    none = np.zeros(len(rows["Mach"]))
    path = engine.gas_path(np.column_stack([rows.get(n, none) for n in engine.input_names]))
    air = air_state(rows["ALT_ft"], rows["Mach"])
    P, T, W = path["P13"], path["T13"], path["W13"]
    P8 = np.maximum(air.P_Pa, P * (1.0 / 1.2) ** 3.5)
    T8 = T * (P8 / P) ** K
    C8 = np.sqrt(2.0 * CP * (T - T8))
    ram = W * rows["Mach"] * np.sqrt(1.4 * GAS_R * air.T_K)
    stream = W * C8 - ram + W * GAS_R * T8 / (P8 * C8) * (P8 - air.P_Pa)
    return float(np.mean(stream / path["net_N"]))


def _mean(study: RegionStudy, output: str, model: str) -> float:
    found = study.row(output, model).validation
    return np.nan if found is None else found.mean_pct


def _success(study: RegionStudy, model: str, output: str = "FN_kN") -> float:
    found = study.row(output, model).validation
    return np.nan if found is None else found.success_pct


def _search(study: RegionStudy, model: str, estimator: str) -> float:
    row = study.search(model, estimator)
    return np.nan if row is None or row.validation is None else row.validation.mean_pct


def _all(table: ByModel, kind: str, model: str, value: str = "mean_pct") -> FloatArray:
    """Figure of one model for every output, in the order of OUTPUTS."""
    return table[kind, model].loc[list(OUTPUTS), value].to_numpy()


def _latest(steps: Sequence[Scaled], name: str, time: Callable[[FloatArray], float]) -> float:
    """Median time of one output over the largest median of the others."""
    found = [float(np.median([time(s.y[:, k]) for s in steps])) for k in range(len(OUTPUTS))]
    at = OUTPUTS.index(name)
    return found[at] / max(value for k, value in enumerate(found) if k != at)


def _early(y: FloatArray) -> float:
    return rise_times(T_S * np.arange(len(y), dtype=np.float64), y)[0]


def _settling(y: FloatArray) -> float:
    """Time after which y stays within 2 % of its end."""
    out = np.flatnonzero(np.abs(y - 1.0) > 0.02)
    return T_S * (float(out[-1]) + 1.0) if len(out) else 0.0


def reproduce(
    engine: str = "single_aisle",
    *,
    regions: Sequence[Region] = REGIONS,
    kinds: Sequence[Kind] = KINDS,
    estimators: Sequence[Estimator] = SEARCHES,
    progress: Progress = silent,
) -> tuple[Study, ...]:
    """Run both studies, static and dynamic; the same engine gives the same numbers.

    The default engine has the bypass ratio nearest to the paper's (5.7, about 5), and an EPR above
    the value below which Torenbeek's generator function is negative. `regions` are low and high.
    """
    engines, static, dynamic = Engines(engine), [], []
    for region in regions:
        progress(0, 0, f"static models, {region.name} altitudes")
        static.append(static_study(engines, region, estimators))
        progress(0, 0, f"dynamic models, {region.name} altitudes")
        dynamic.append(dynamic_study(static[-1], engines.flown, kinds))
    return _static(engines, static), _dynamic(dynamic)


def _static(engines: Engines, studies: Sequence[RegionStudy]) -> Study:
    rows = [row for study in studies for row in study.rows]
    forms = dict.fromkeys(row.fit.model.reconstruction for row in rows if row.fit)
    low, high = studies
    return Study(
        key="static",
        title="Static models",
        source="sections 3 and 5.1, tables 5 to 13",
        text="Each model is fitted to the identification flights of its region and scored on "
        "flights in the middle of the mesh; 'chained' has its inputs predicted too. The CLM is the "
        "engine as designed, the flown one has 0.5 % of build scatter. Not in the paper's text: "
        + "; ".join(form for form in forms if form)
        + ".",
        claims=static_claims(engines, low, high),
        tables=[
            _parameters(studies),
            _estimators(studies),
            *(_scores(study, PRESSURES, "Tables 8 to 10") for study in studies),
            *(_scores(study, ("FN_kN", "FF_kgph"), "Tables 11 to 13") for study in studies),
        ],
        results={
            "rows": [row.document() for row in rows],
            "searches": [row.document() for study in studies for row in study.searches],
            "correction_degrees": {s.region.name: [list(d) for d in s.degrees] for s in studies},
        },
    )


def _dynamic(regions: Sequence[DynamicStudy]) -> Study:
    rows = merged(pd.concat([region.rows for region in regions]))
    steps = [flight for region in regions for flight in region.steps]
    return Study(
        key="dynamic",
        title="Dynamic models",
        source="sections 4 and 5.2, figures 10 to 21, table 14",
        text="Fitted at every identification flight; parameters interpolated over altitude and "
        "amplitude for the validation flights. Success: t10 and t90 each within 10 %. State-space "
        "models are interpolated in modal form unless their name says otherwise; where the free "
        "run diverges, an error counts as 1e6 %.",
        claims=dynamic_claims(rows, steps, [region.tables for region in regions]),
        tables=[*(_responses(own, kind) for kind, own in _by_kind(rows)), _combinations(rows)],
        pictures=dynamic_pictures(regions[-1]),
        results={"rows": rows.to_dict("records")},
    )


def _by_kind(rows: pd.DataFrame) -> Iterator[tuple[Kind, pd.DataFrame]]:
    for kind in KINDS:
        own = rows[rows["kind"] == kind]
        if len(own):
            yield kind, own


def _parameters(studies: Sequence[RegionStudy]) -> Table:
    """Tables 5 and 6: parameter values by Levenberg-Marquardt and by swarm."""
    rows = []
    for study, model in product(studies, ("Cold Thrust", "Yoder+")):
        found = [study.search(model, name) for name in ("levenberg-marquardt", "swarm")]
        fits = [row.fit for row in found if row and row.fit]
        for k, p in enumerate(fits[0].model.parameters if fits else ()):
            values = (one[k] for one in (fits[0].values, fits[0].sd, fits[-1].values))  # noqa: PD011 -- no data frame
            rows.append((f"{study.region.name}: {model} {p.name} [{p.unit}]", *values))
    head = ("parameter", "Levenberg-Marquardt", "sd", "swarm")
    return table_of("Tables 5 and 6: parameter values", head, rows)


def _estimators(studies: Sequence[RegionStudy]) -> Table:
    """Every grey box by every estimator: mean error on the identification flights."""
    names = list(dict.fromkeys(r.fit.estimator for s in studies for r in s.searches if r.fit))
    rows = []
    for study in studies:
        for model in dict.fromkeys(row.model for row in study.searches):
            found = [study.search(model, name) for name in names]
            errors = [row.fit.score.mean_pct if row and row.fit else None for row in found]
            rows.append((f"{study.region.name}: {model}", *errors))
    head = ("model", *(f"{name} [%]" for name in names))
    return table_of("Estimators: mean error on identification flights", head, rows)


def _scores(study: RegionStudy, outputs: Sequence[str], which: str) -> Table:
    head = ("output", "model", "identification [%]", "validation [%]", "largest [%]", "success [%]",
            "chained [%]", "remark")  # fmt: skip
    rows = []
    for row in study.rows:
        fit, new, chained = row.fit, row.validation, row.chained
        values: tuple[float | None, ...] = (None,) * 5
        if fit and new and chained:
            values = (
                fit.score.mean_pct, new.mean_pct, new.max_pct, new.success_pct, chained.mean_pct
            )  # fmt: skip
        if row.output in outputs:
            remark = row.failure or "; ".join(fit.advice if fit else ())
            rows.append((row.output, row.model, *values, remark))
    return table_of(f"{which}: mean relative errors, {study.region.name} altitudes", head, rows)


def _responses(rows: pd.DataFrame, kind: Kind) -> Table:
    """Success and mean error of every model and output, figures 16 to 21."""
    head = ("model", *(f"{name} success [%]" for name in OUTPUTS),
            *(f"{name} error [%]" for name in OUTPUTS))  # fmt: skip
    columns = [(value, name) for value in ("success_pct", "mean_pct") for name in OUTPUTS]
    wide = rows.pivot_table(
        ["success_pct", "mean_pct"], "model", "output", sort=False, dropna=False
    )
    lines = [(model, *wide.loc[model, columns]) for model in rows["model"].unique()]
    first, second = FIGURES[kind]
    return table_of(f"Figures {first} and {second}: responses to a {kind}", head, lines)


def _combinations(rows: pd.DataFrame) -> Table:
    """Table 14: how outputs are best joined for an order, by success over all outputs."""
    lines: list[tuple[str | float, ...]] = []
    for kind, own in _by_kind(rows):
        mean = own.groupby("model")["success_pct"].mean()
        for order in (2, 3):
            known = [group for group in GROUPS if f"{group} O/{order}" in mean]
            best = max(known, key=lambda group: mean[f"{group} O/{order}"])
            joined = "; ".join(" + ".join(part) for part in GROUPS[best])
            lines.append((kind, f"O/{order}", joined, mean[f"{best} O/{order}"]))
    head = ("response", "order", "best combination of outputs", "success [%]")
    return table_of("Table 14: combinations of outputs", head, lines)
