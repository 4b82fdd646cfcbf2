"""The Citation X paper on virtual flights: its tables and figures, and its claims, in two studies.

Every number comes from the virtual engine: models are compared with an engine model, as the paper
compares them with a simulator, and an error of 1 % says nothing about an engine.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from itertools import product
from typing import Any

from eval.report.tables import Table
from eval.reproduce.citation_claims import dynamic_claims, static_claims
from eval.reproduce.citation_dynamic import (
    GROUPS,
    DynamicRow,
    DynamicStudy,
    dynamic_study,
    merged,
)
from eval.reproduce.citation_figures import dynamic_pictures
from eval.reproduce.citation_static import (
    PRESSURES,
    Engines,
    RegionStudy,
    StaticRow,
    static_study,
)
from eval.reproduce.mesh import KINDS, OUTPUTS, REGIONS, Kind, Region
from eval.reproduce.study import Study, table_of
from training.static_fit import SEARCHES, Estimator

CONTRADICTIONS = (
    (
        "The conclusion says that the laws of Mattingly, Torenbeek, Wanner and Aerospatiale give "
        "gross thrust; the originals of the first two are laws of net thrust. They are fitted with "
        "and without drag."
    ),
    (
        "Section 4.3 takes C = I, which needs as many outputs as states, and shows one output of "
        "order 4, which needs a canonical form with 2 n parameters. Both are fitted."
    ),
    (
        "Equations 1 to 3 disturb at t = 1 s, the text of section 2.3.2 at t = 0. The onset is "
        "explicit here, and times count from it."
    ),
    (
        "b_1 and b_2 of equation 17 are 0 or 1: with the usual constants (0.73, 1.50) the second "
        "moment of such a swarm diverges. P = 0.75 is used with these draws."
    ),
    "The conclusion takes the exception of C4 from Table 10, which is ITT: Table 11 is meant.",
)
_FIGURES = {"step": (16, 17), "impulse": (18, 19), "ramp": (20, 21)}


def reproduce(
    engine: str = "single_aisle",
    *,
    regions: Sequence[Region] = REGIONS,
    kinds: Sequence[Kind] = KINDS,
    estimators: Sequence[Estimator] = SEARCHES,
    watch: Callable[[str], None] = lambda _: None,
) -> tuple[Study, ...]:
    """Run both studies, static and dynamic; the same engine gives the same numbers.

    The default engine has the bypass ratio nearest to the paper's (5.7, about 5), and an EPR above
    the value below which Torenbeek's generator function is negative. `regions` are low and high.
    """
    engines, static, dynamic = Engines(engine), [], []
    for region in regions:
        watch(f"Static models, {region.name} altitudes")
        static.append(static_study(engines, region, estimators))
        watch(f"Dynamic models, {region.name} altitudes")
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
            "rows": [_row(row) for row in rows],
            "searches": [_row(row) for study in studies for row in study.searches],
            "correction_degrees": {s.region.name: [list(d) for d in s.degrees] for s in studies},
        },
    )


def _dynamic(regions: Sequence[DynamicStudy]) -> Study:
    rows = merged([row for region in regions for row in region.rows])
    steps = [flight for region in regions for flight in region.steps]
    kinds = [kind for kind in KINDS if any(row.kind == kind for row in rows)]
    return Study(
        key="dynamic",
        title="Dynamic models",
        source="sections 4 and 5.2, figures 10 to 21, table 14",
        text="Fitted at every identification flight; parameters interpolated over altitude and "
        "amplitude for the validation flights. Success: t10 and t90 each within 10 %. State-space "
        "models are interpolated in modal form unless their name says otherwise; where the free "
        "run diverges, an error counts as 1e6 %.",
        claims=dynamic_claims(rows, steps, [region.tables for region in regions]),
        tables=[*(_responses(rows, kind) for kind in kinds), _combinations(rows, kinds)],
        pictures=dynamic_pictures(rows, regions),
        results={"rows": [asdict(row) for row in rows]},
    )


def _parameters(studies: Sequence[RegionStudy]) -> Table:
    """Tables 5 and 6: parameter values by Levenberg-Marquardt and by swarm."""
    rows = []
    for study, model in product(studies, ("Cold Thrust", "Yoder+")):
        found = [study.search(model, name) for name in ("levenberg-marquardt", "swarm")]
        fits = [row.fit for row in found if row and row.fit]
        for k, p in enumerate(fits[0].model.parameters if fits else ()):
            values = fits[0].values[k], fits[0].sd[k], fits[-1].values[k]
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


def _responses(rows: Sequence[DynamicRow], kind: Kind) -> Table:
    """Success and mean error of every model and output, figures 16 to 21."""
    own = {(row.model, row.output): row for row in rows if row.kind == kind}
    head = ("model", *(f"{name} success [%]" for name in OUTPUTS),
            *(f"{name} error [%]" for name in OUTPUTS))  # fmt: skip
    lines = [
        (
            model,
            *(own[model, name].success_pct for name in OUTPUTS),
            *(own[model, name].mean_pct for name in OUTPUTS),
        )
        for model in dict.fromkeys(model for model, _ in own)
    ]
    first, second = _FIGURES[kind]
    return table_of(f"Figures {first} and {second}: responses to a {kind}", head, lines)


def _combinations(rows: Sequence[DynamicRow], kinds: Sequence[Kind]) -> Table:
    """Table 14: how outputs are best joined for an order, by success over all outputs."""
    lines: list[tuple[str | float, ...]] = []
    for kind, order in product(kinds, (2, 3)):
        mean = {
            group: sum(row.success_pct for row in own) / len(own)
            for group in GROUPS
            if (own := [r for r in rows if r.kind == kind and r.model == f"{group} O/{order}"])
        }
        best = max(mean, key=lambda group: mean[group])
        joined = "; ".join(" + ".join(part) for part in GROUPS[best])
        lines.append((kind, f"O/{order}", joined, mean[best]))
    head = ("response", "order", "best combination of outputs", "success [%]")
    return table_of("Table 14: combinations of outputs", head, lines)


def _row(row: StaticRow) -> dict[str, Any]:
    scores = {"validation": row.validation, "chained": row.chained}
    return {
        "region": row.region,
        "output": row.output,
        "model": row.model,
        "failure": row.failure,
        **{name: vars(found) if found else None for name, found in scores.items()},
        "fit": row.fit.document() if row.fit else None,
    }
