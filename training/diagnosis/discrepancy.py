r"""What a simulator gets wrong by itself, learned from flights that it was not identified on.

Left-out flights d (recorded less simulated) give, per channel c and band b of `metric`,

    V_cb(t) = A_cb + K_cb g_b(t) + (3e-4 range)^2        by Gaussian maximum likelihood,
    tau_cb  = mean over effects k and logs of (s' d)^2 / (s' s), both whitened, at least 1,

with g the activity of the simulated output in the band; steady maps as polynomials of power,
orthonormal over what was flown, whose coefficients vary between flights and between the engines of
one; and how much each effect seems to take of flights in which nothing is known to act. Effects
that seem to act in all of them are the simulator's own error.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Final

import numpy as np
from pydantic import TypeAdapter
from scipy.ndimage import uniform_filter1d
from scipy.optimize import minimize

from narxcal.support.arrays import FloatArray
from training.diagnosis.dictionary import Dictionary, Node
from training.diagnosis.fit import Frame
from training.diagnosis.metric import BLOCK, Metric, Record, bands_of, block_means
from training.diagnosis.nuisances import BUILD, OFFSET, Nuisances

BANDS: Final = 4
_TERMS: Final = 4  # of the polynomials of power
_FINEST: Final = 3e-4  # of a range: a recorder's digits
_SMOOTH: Final = (33, 9, 3, 1)  # samples of a band that its activity is averaged over
_WEAK: Final = 1e-3  # of a column of a polynomial: powers that were hardly flown
_UNBOUND: Final = 1e3
_STEADY: Final = (
    "deterioration",
    "sensor_bias",
    "sensor_gain",
    "throttle_bias",
    "temperature_effect",
)
_FEW: Final = 12.0  # overdispersion of two flights judged with what the other taught


@dataclass(frozen=True)
class Discrepancy:
    """What was learned, by channel; `flights` is from how many.

    `noise` holds A and K per band, `tau` the overdispersion per band; `basis` the coefficients of
    the orthonormal polynomials of power, (terms, terms); `common` and `own` their standard
    deviations between flights and between engines; `natural` what every effect gained, summed over
    the `logs` and divided by the `overdispersion` that all have in common.
    """

    flights: int
    basis: tuple[tuple[float, ...], ...]
    noise: Mapping[str, tuple[tuple[float, float], ...]]
    tau: Mapping[str, tuple[float, ...]]
    common: Mapping[str, tuple[float, ...]]
    own: Mapping[str, tuple[float, ...]]
    natural: Mapping[str, float]
    logs: int = 1
    overdispersion: float = 1.0

    def variance(self, record: Record) -> list[FloatArray]:
        """Variance per band, (flights, time / 8^b, outputs)."""
        activity, outputs = activities(record.flights.y), record.flights.signals.outputs
        found = []
        for b, each in enumerate(activity):
            rows = []
            for c, name in enumerate(outputs):
                a, k = self.noise[name][b]
                here = a + k * each[..., c] + _least(record, c, b)
                rows.append(here * self.tau[name][b] * self.overdispersion)
            found.append(np.stack(rows, axis=-1))
        return found

    def nuisances(self, record: Record) -> Nuisances:
        """Maps of each flight and of each log of it, Gaussian and not bounded."""
        group = record.group
        flights, outputs = record.flights, record.flights.signals.outputs
        powers = _polynomials(record, np.array(self.basis))
        columns, kinds = [], []
        for c, name in enumerate(outputs):
            for j in range(len(powers)):
                for which in dict.fromkeys(group):
                    at = np.array([g == which for g in group])
                    columns.append(
                        _placed(powers[j] * self.common[name][j] * at[:, None], c, flights.y)
                    )
                    kinds.append(BUILD)
                for f in range(len(flights.y)):
                    at = np.arange(len(flights.y)) == f
                    columns.append(
                        _placed(powers[j] * self.own[name][j] * at[:, None], c, flights.y)
                    )
                    kinds.append(OFFSET)
        limit = np.full(len(columns), _UNBOUND)
        return Nuisances(np.stack(columns), tuple(kinds), ("",) * len(columns), limit)

    def spread(self, name: str) -> float:
        """How much more than chance an effect gains on flights in which nothing acts.

        A further flight differs from n by 1 + 1 / n times the variance that these showed.
        """
        own = max(1.0, (1.0 + self.natural.get(name, 0.0)) / (1.0 + self.logs))
        return own * (1.0 + 1.0 / self.flights)

    def document(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {"schema": "narxcal.discrepancy/1", **asdict(self)}


def read(found: Mapping[str, Any]) -> Discrepancy:
    """From the plain values of `document`; raises `ValueError` for others."""
    return TypeAdapter(Discrepancy).validate_python(found)


def learn(record: Record, dictionary: Dictionary) -> Discrepancy:
    """Learn from flights that the simulator was not identified on.

    What each effect gains by itself is found on every log with what the other logs taught; one log
    alone is judged by what it taught itself, and everything counts for a twelfth.
    """
    nodes = dictionary.nodes
    found = _once(record, nodes)
    rows = range(len(record.real))
    if len(rows) < 2:
        return replace(found, overdispersion=_FEW)
    gains = [_gains(record, nodes, f) for f in rows]
    natural = {name: float(sum(each[name] for each in gains)) for name in nodes}
    mean = float(np.mean([natural[name] for name in nodes if _moves(name)])) / len(rows)
    dispersion = max(1.0, mean)
    natural = {name: gain / dispersion for name, gain in natural.items()}
    return replace(found, natural=natural, logs=len(rows), overdispersion=dispersion)


def _gains(record: Record, nodes: Mapping[str, list[Node]], f: int) -> dict[str, float]:
    """What each effect gains on log f by what the others taught, per linear parameter."""
    others = [k for k in range(len(record.real)) if k != f]
    taught = _once(record.some(others), {n: _of(each, others) for n, each in nodes.items()})
    one = record.some([f])
    noise, metric = taught.nuisances(one), Metric(one, taught.variance(one))
    frame = Frame(one, metric, one.gap, noise, assumed=False)
    found = {}
    for name, each in nodes.items():
        best = frame.fit(_of(each, [f]))
        gain = (frame.none.cost - best.solved.cost) / best.solved.tau
        found[name] = max(gain, 0.0) / best.node.size
    return found


def _of(nodes: Sequence[Node], rows: Sequence[int]) -> list[Node]:
    """The nodes on some logs."""
    return [replace(node, rows=node.rows[:, list(rows)]) for node in nodes]


def _once(record: Record, nodes: Mapping[str, list[Node]]) -> Discrepancy:
    """Noise, maps and overdispersion of a record."""
    group = record.group
    outputs = record.flights.signals.outputs
    basis = _basis(record)
    powers = _polynomials(record, basis)
    gap, coefficients = _without_maps(record, record.gap, powers)
    noise = _noises(record, gap)
    common, own = _variances(coefficients, group)
    ones = dict.fromkeys(outputs, (1.0,) * BANDS)
    plain = Discrepancy(
        len(set(group)),
        tuple(map(tuple, basis.tolist())),
        {n: tuple(map(tuple, noise[c].tolist())) for c, n in enumerate(outputs)},
        ones,
        {n: tuple(common[:, c].tolist()) for c, n in enumerate(outputs)},
        {n: tuple(own[:, c].tolist()) for c, n in enumerate(outputs)},
        {},
    )
    return _dispersed(plain, record, gap, powers, nodes)


def _dispersed(
    plain: Discrepancy,
    record: Record,
    gap: FloatArray,
    powers: FloatArray,
    nodes: Mapping[str, list[Node]],
) -> Discrepancy:
    """With the overdispersion per cell that effects find, and what each gains by itself."""
    outputs = record.flights.signals.outputs
    moving = [n for name, each in nodes.items() if _moves(name) for n in each]
    shapes = [_without_maps(record, _shape(node), powers)[0] for node in moving]
    metric = Metric(record, plain.variance(record))
    rest, tau = metric.whiten(gap[None])[0], np.ones((BANDS, len(outputs)))
    ratios: list[list[float]] = [[] for _ in range(BANDS * len(outputs))]
    for shape in shapes:
        s = metric.whiten(shape[None])[0]
        for cell in range(BANDS * len(outputs)):
            for f in range(len(gap)):
                here = (metric.cell == cell) & (metric.flight == f)
                size = float(s[here] @ s[here])
                if size > 1e-9 * float(s @ s):
                    ratios[cell].append(float(s[here] @ rest[here]) ** 2 / size)
    for cell, found in enumerate(ratios):
        tau[cell // len(outputs), cell % len(outputs)] = max(1.0, float(np.mean(found or [1.0])))
    return replace(plain, tau={n: tuple(tau[:, c].tolist()) for c, n in enumerate(outputs)})


def _moves(name: str) -> bool:
    return name.partition(":")[0] not in _STEADY


def _shape(node: Node) -> FloatArray:
    """Response of a node, or its first slope where it is linear."""
    rows = node.rows.astype(np.float64)
    return np.asarray(rows[0] if rows[0].any() else rows[1])


def activities(y: FloatArray) -> list[FloatArray]:
    """Squared bands of `y` (flights, time, outputs), averaged over some of a band's own samples."""
    parts = bands_of(y, BANDS)
    parts[-1] = parts[-1] - parts[-1].mean(axis=1, keepdims=True)
    squares = [part**2 for part in parts]
    return [
        uniform_filter1d(square, size, axis=1, mode="nearest")
        for square, size in zip(squares, _SMOOTH, strict=True)
    ]


def _least(record: Record, c: int, band: int) -> float:
    """Variance of a recorder's digits in a band."""
    return float((_FINEST * record.span[c]) ** 2 / BLOCK**band)


def _noises(record: Record, gap: FloatArray) -> FloatArray:
    """A and K per channel and band, (outputs, bands, 2), by Gaussian maximum likelihood."""
    activity, parts = activities(record.flights.y), bands_of(gap, BANDS)
    outputs = gap.shape[-1]
    found = np.zeros((outputs, BANDS, 2))
    for b in range(BANDS):
        inside = block_means(record.known.astype(float), BLOCK**b) > 0.5
        for c in range(outputs):
            use = inside[..., c]
            r2, g = parts[b][..., c][use] ** 2, activity[b][..., c][use]
            found[c, b] = _likeliest(r2, g, _least(record, c, b))
    return found


def _likeliest(r2: FloatArray, g: FloatArray, least: float) -> FloatArray:
    """A and K of `V = A + K g + least` that make squares `r2` likeliest."""
    mean, active = max(float(r2.mean()), 1e-30), max(float(g.mean()), 1e-30)

    def cost(z: FloatArray) -> float:
        v = np.exp(z[0]) + np.exp(z[1]) * g + least
        return float(np.mean(np.log(v) + r2 / v))

    start = np.log([0.5 * mean, 0.5 * mean / active])
    best = minimize(cost, start, method="Nelder-Mead", options={"maxiter": 400})
    return np.asarray(np.exp(best.x))


def _basis(record: Record) -> FloatArray:
    """Coefficients (terms, terms) of polynomials of power that are orthonormal over the flights."""
    p = record.flights.signals.power(record.flights.y)[record.unit >= 0]
    rows = p[:, None] ** np.arange(_TERMS)
    _, r = np.linalg.qr(rows / np.sqrt(len(p)))
    diagonal = np.diag(r)
    strong = np.abs(diagonal) > _WEAK
    found = np.linalg.inv(r)
    return np.asarray(found[:, : int(strong.sum())].T)


def _polynomials(record: Record, basis: FloatArray) -> FloatArray:
    """The polynomials (terms, flights, time) at the powers of these flights."""
    p = record.flights.signals.power(record.flights.y)
    rows = p[..., None] ** np.arange(basis.shape[1])
    return np.moveaxis(rows @ basis.T, -1, 0)


def _without_maps(
    record: Record, gap: FloatArray, powers: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The gap less the best polynomials of each log, and their coefficients (flights, terms, n)."""
    rest, known = np.zeros_like(gap), record.known
    coefficients = np.zeros((len(gap), len(powers), gap.shape[-1]))
    for f, c in np.ndindex(len(gap), gap.shape[-1]):
        use = known[f, :, c]
        rows = powers[:, f, use].T
        best, *_ = np.linalg.lstsq(rows, gap[f, use, c], rcond=None)
        coefficients[f, :, c] = best
        rest[f, use, c] = gap[f, use, c] - rows @ best
    return rest, coefficients


def _variances(coefficients: FloatArray, group: Sequence[int]) -> tuple[FloatArray, FloatArray]:
    """Standard deviations (terms, outputs) between flights, and between engines of one."""
    groups = [coefficients[np.array([g == which for g in group])] for which in dict.fromkeys(group)]
    many = [each for each in groups if len(each) > 1]
    means = np.stack([each.mean(axis=0) for each in groups])
    if not many:
        size = np.sqrt((coefficients**2).mean(axis=0))
        return size / np.sqrt(2.0), size / np.sqrt(2.0)
    within = np.stack([each.var(axis=0, ddof=1) for each in many]).mean(axis=0)
    members = float(np.mean([len(each) for each in groups]))
    between = np.maximum((means**2).mean(axis=0) - within / members, 0.25 * within)
    return np.sqrt(between), np.sqrt(within)


def _placed(values: FloatArray, c: int, like: FloatArray) -> FloatArray:
    found = np.zeros_like(like)
    found[..., c] = values
    return found
