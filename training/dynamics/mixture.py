"""Which model leads a speed, and the mixture of models in each other output, by what was held out.

The training logs are divided into folds (`training.folds`). In each, steady state, lags, network
and simple models are fitted anew to the rest, and all of them run free over what is held out. The
test logs take no part. The network alone is shown whatever is chosen.

**Speeds** have one model, for response times of a mixture are those of none. The network on lags
leads. The lags alone do where they have clearly less loss of response times
(`training.responses.transients`, `training.folds.clearly_less`) or, neither having less, clearly a
lower RMSE, and where no transient could be judged: nothing then says that the network carries over,
while lags rest on the law of rotors. A simple model leads only where it has clearly less loss on
whole recordings: in a region of one it follows what it was fitted to a minute away.

**Other outputs** are mixed. With E_r (models, models) the mean products of errors over piece r (a
recording, or a region), the weights w >= 0 of sum 1 minimise (stacking: Wolpert 1992, Neural
Networks 5(2), with a Dirichlet prior of equal weights p)

    sum_r 1/2 ln(w' E_r w) - a sum_i p_i ln w_i,        a = `_PRIOR` pieces

so that every piece counts alike. All rest on one steady state, whose error they share: it says
nothing about weights and hides what does, so errors pass a high pass of `_MOVES_S` first. One model
leads alone if its errors are clearly (`training.folds.surely_below`) below those of every other
model and of the mixture with weights by the other pieces. Lags and network share one model: the
network's deviation takes its share of both. With fewer than two pieces nothing says that lags and
network carry over, and the simple models have equal weights.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.optimize import minimize
from scipy.signal import lfilter

from data_prep.log import Log
from narxcal.calibration.dynamic import DynamicCalibration
from narxcal.calibration.members import Kind, Member
from narxcal.channels import spools_of
from narxcal.support.arrays import BoolArray, FloatArray, known_mean
from narxcal.support.errors import DataError
from narxcal.support.progress import Progress, silent
from training.config import RunConfig
from training.dynamics.baselines import Baselines, run_of
from training.folds import LogFold, clearly_less, clustered, log_folds, surely_below
from training.responses.transients import Responses, responses
from training.screening.levels import lag_of, level_of

NETWORK: Final = "network"
LAGS: Final = "lags"
# The steady state itself is a first-order lag without a time constant: the fits would find it. A
# share of it would move at once with every input, and with it all response times.
SIMPLE: Final[tuple[Kind, ...]] = ("first_order", "arx", "output_error")
MODELS: Final = (NETWORK, LAGS, *SIMPLE)
_PRIOR: Final = 0.5  # pieces that the prior weights count as; 0.3 to 2 differ by 1 %
# Time constant of the high pass. Of none, 120, 60, 20 and 5 s it leaves the least error on AGTF30,
# micro gas turbine, test cell and JetCat together; without the micro gas turbine 5 s does. Found
# once from stored fits, no command repeats it; the Citation had been seen.
_MOVES_S: Final = 20.0
_LEAST_WEIGHT: Final = 0.02  # of a simple model; what less it changes is within rounding of figures
_UNIT_US: Final = 3.0  # nominal cost of a sample-step of the network behind lags
# Error over the median of the others: errors of good logs scatter by a factor of about two.
_SUSPECT: Final = 3.0
_LEAST_ERROR: Final = 1e-9  # of the largest error: models without any error compare, too
_FAR: Final = 12.0  # of ln(weight) from the largest: nothing

Refit = Callable[[Sequence[Log]], tuple[DynamicCalibration, Mapping[str, Any]]]


class HeldRun(NamedTuple):
    """Free run over a log that was held out, its steady state and measurement, (time, outputs).

    `inside` (time,) tells where the inputs lie within the envelope of what was fitted.
    """

    steady: FloatArray
    model: FloatArray
    measured: FloatArray
    piece: str
    whole: bool
    inside: BoolArray


class HeldOut(NamedTuple):
    """Free runs (models, time, outputs) over a held-out log, in the order of `MODELS`.

    `steady` and `measured` are (time, outputs), `inside` (time,) tells where the inputs lie within
    the envelope of what was fitted; `piece` is what the log counts for; `responses` are those of
    each model. A model that the calibration lacks is NaN.
    """

    log: str
    piece: str
    whole: bool
    models: FloatArray
    steady: FloatArray
    measured: FloatArray
    inside: BoolArray
    dt_s: float
    responses: tuple[Responses, ...]

    def mixed(self, weights: FloatArray) -> FloatArray:
        """Free run (time, outputs) of the mixture with `weights` (models, outputs)."""
        return np.asarray(np.einsum("mo,mto->to", weights, np.nan_to_num(self.models)))


@dataclass(frozen=True, eq=False)
class Mixture:
    """Weights (models, outputs) in the order of `MODELS`, and what they rest on.

    Without anything `held` out they are those of the prior, or the network alone; `status` says
    why.
    """

    channels: tuple[str, ...]
    weights: FloatArray
    held: tuple[HeldOut, ...]
    status: str

    @property
    def free_runs(self) -> tuple[HeldRun, ...]:
        """Held-out free runs of the mixture."""
        mixed = [one.mixed(self.weights) for one in self.held]
        return tuple(
            HeldRun(one.steady, run, one.measured, one.piece, one.whole, one.inside)
            for one, run in zip(self.held, mixed, strict=True)
        )

    def by_lags(self, why: str) -> Mixture:
        """First-order lags alone, which lead where the mixture does not settle."""
        alone = np.zeros_like(self.weights)
        alone[MODELS.index("first_order")] = 1.0
        return replace(self, weights=alone, status=why)

    def applied(
        self, calibration: DynamicCalibration, baselines: Mapping[str, Any]
    ) -> DynamicCalibration:
        """The calibration with the fitted simple models as members, by their weights."""
        simple = Baselines.from_json(baselines)
        members: list[Member] = []
        for k, weights in enumerate(self.weights.T):
            for kind, weight in zip(SIMPLE, weights[2:], strict=True):
                if weight > 0.0:
                    members.append(simple.member(kind, k, calibration.dt_s, float(weight)))
        if calibration.lag is not None and self.weights[1].any():
            own = np.maximum(self.weights[:2].sum(axis=0), np.finfo(float).tiny)
            calibration = calibration.with_network_share(self.weights[0] / own)
        return calibration.with_members(members)

    def row(self) -> dict[str, Any]:
        """JSON-able: per channel weights, held-out errors, levels and lags of whole recordings."""
        found: dict[str, Any] = {}
        for k, name in enumerate(self.channels):
            weights = dict(zip(MODELS, self.weights[:, k].tolist(), strict=True))
            found[name] = {"weights": {one: round(w, 4) for one, w in weights.items() if w > 0.0}}
            if self.held:
                errors = np.concatenate(
                    [(one.models - one.measured)[:, :, k] for one in self.held], 1
                )
                rms = np.sqrt(known_mean(errors.T**2))
                pairs = zip(MODELS, rms.tolist(), strict=True)
                known = {m: e if np.isfinite(e) else None for m, e in pairs}
                mixed = np.concatenate(
                    [(one.mixed(self.weights) - one.measured)[:, k] for one in self.held]
                )
                mean = float(known_mean(mixed**2))
                known["mixture"] = float(np.sqrt(mean)) if np.isfinite(mean) else None
                found[name]["held_out_rmse"] = known
                if spools_of([name]):
                    found[name]["held_out_responses"] = self._responses(k)
            whole = [(one.mixed(self.weights), one) for one in self.held if one.whole]
            if whole:
                levels = [level_of(y[:, k : k + 1], one.measured[:, k : k + 1]) for y, one in whole]
                lags = [lag_of(y[:, [k]], one.measured[:, [k]], one.dt_s) for y, one in whole]
                found[name]["held_out_level"] = _known(levels)
                found[name]["held_out_lag_s"] = _known(lags)
        return {
            "status": self.status,
            "held_out": [one.log for one in self.held],
            "channels": found,
            "suspects": list(self.suspects),
        }

    def _responses(self, k: int) -> dict[str, dict[str, float | None]]:
        """By model of a speed: transients passed and judged, mean loss and its standard error."""
        found = {}
        for number, model in enumerate(MODELS):
            pieces: dict[str, list[FloatArray]] = {}
            for one in self.held:
                each = one.responses[number]
                pieces.setdefault(one.piece, []).append(
                    np.stack([each.losses[:, k], each.passed[:, k]])
                )
            both = [np.concatenate(each, axis=1) for each in pieces.values()]
            mean, error, _ = clustered([each[0] for each in both])
            passed = np.concatenate([each[1] for each in both])
            found[model] = {
                "passed": int(np.nansum(passed)),
                "judged": int(np.isfinite(passed).sum()),
                "loss": mean if np.isfinite(mean) else None,
                "loss_error": error if np.isfinite(error) else None,
            }
        return found

    @property
    def suspects(self) -> tuple[str, ...]:
        """Held-out logs on which every model is far worse than on the others, one sentence each."""
        held = [one for one in self.held if one.whole]
        if len(held) < 3 or len(held) < len(self.held):
            return ()
        errors = [np.sqrt(known_mean((one.models - one.measured) ** 2, 1)) for one in held]
        best = np.nanmin(np.where(np.isfinite(errors), errors, np.inf), axis=1)
        found = []
        for k, one in enumerate(held):
            others = np.median(np.delete(best, k, axis=0), axis=0)
            ratios = np.where(np.isfinite(best[k]) & (others > 0.0), best[k] / others, 0.0)
            worst = int(np.argmax(ratios))
            if ratios[worst] > _SUSPECT:
                found.append(
                    f"{one.log} does not fit the other logs: held out, {self.channels[worst]} is "
                    f"wrong by {best[k, worst]:.3g}, {ratios[worst]:.1f} times as much as usual, "
                    "in every model; check it, or leave it out"
                )
        return tuple(found)


def network_alone(calibration: DynamicCalibration, status: str) -> Mixture:
    """Nothing was held out."""
    weights = np.zeros((len(MODELS), len(calibration.output_names)))
    weights[0] = 1.0
    return Mixture(calibration.output_names, weights, (), status)


def choose_mixture(
    config: RunConfig,
    logs: Sequence[Log],
    refit: Refit,
    whole: tuple[DynamicCalibration, Mapping[str, Any]],
    progress: Progress = silent,
) -> Mixture:
    """Judge all models on folds of the training logs.

    `refit` fits calibration and baselines to some logs; `whole` are those fitted to all of them,
    and a linear model that is stable in the folds alone has no share.
    """
    calibration, fitted = whole
    folds = log_folds(logs, lambda log: run_of(calibration, log).steady[:, 0])
    steps = sum(config.train.iterations) * config.train.starts
    cost = 1e-6 * _UNIT_US * steps * sum(len(log) for fold in folds for log in fold.fitted)
    if cost > config.train.choice_s:
        limit = f"choice_s = {config.train.choice_s:g}"
        return network_alone(calibration, f"no choice: folds take {cost:.0f} CPU s, {limit}")
    held: list[HeldOut] = []
    lost: dict[str, str] = {}
    for number, fold in enumerate(folds):
        progress(number, len(folds), "judging on held-out parts")
        try:
            found, own = refit(fold.fitted)
        except DataError as error:
            lost[fold.name] = str(error.problem)
            continue
        simple = Baselines.from_json(own)
        held += [held_out(config, found, simple, log, fold) for log in fold.judged]
    simple = Baselines.from_json(fitted)
    fits = [
        np.array([True, calibration.lag is not None, *(simple.has(kind, k) for kind in SIMPLE)])
        for k in range(len(calibration.output_names))
    ]
    weights = np.zeros((len(MODELS), len(calibration.output_names)))
    for k, name in enumerate(calibration.output_names):
        if spools_of([name]):
            weights[leader_of(held, k, fits[k]), k] = 1.0
        else:
            weights[:, k] = weights_of(error_products(held, k), fits[k])
    if not held:
        reason = next(iter(lost.values()), "nothing could be held out")
        status = f"usual weights: {reason}; add a longer or another log"
        return Mixture(calibration.output_names, weights, (), status)
    parts = dict.fromkeys(Path(one.piece).name for one in held)
    status = f"weights by {len(parts)} held-out parts of the training logs: {', '.join(parts)}"
    if lost:
        status += "; too little is left without " + ", ".join(lost)
    return Mixture(calibration.output_names, weights, tuple(held), status)


def held_out(
    config: RunConfig,
    calibration: DynamicCalibration,
    baselines: Baselines,
    log: Log,
    fold: LogFold,
) -> HeldOut:
    """Run all models over one held-out log."""
    own = calibration.for_engine(log.source.engine, or_mean=True)
    run = run_of(calibration, log)
    inputs, start = log.matrix(own.input_names), run.measured[0]
    lags = np.full_like(run.measured, np.nan)
    if own.lag is not None:
        nothing = np.zeros(len(own.output_names))
        lags = own.with_network_share(nothing).simulate(inputs, start)
    models = (
        own.simulate(inputs, start),
        lags,
        *(baselines.simulate(kind, run.steady, start, own.dt_s) for kind in SIMPLE),
    )
    judged = [responses(log, each, own.output_names, config) for each in models]
    return HeldOut(
        log.name, fold.piece(log), fold.whole,
        np.stack(models), run.steady, run.measured, own.steady.inside(inputs), own.dt_s,
        tuple(judged),
    )  # fmt: skip


def leader_of(held: Sequence[HeldOut], k: int, fitted: BoolArray) -> int:
    """Number of the model that leads speed `k`; `fitted` (models,) are those fitted to all logs."""
    lags = MODELS.index(LAGS)
    if fitted[lags] and not any(np.isfinite(one.responses[0].losses[:, k]).any() for one in held):
        return lags
    best, errors = 0, np.diagonal(error_products(held, k, high_pass=False), axis1=1, axis2=2)
    for other in np.flatnonzero(fitted)[1:].tolist():
        if not len(errors) or not np.isfinite(errors[:, other]).all():
            continue
        pieces: dict[str, list[FloatArray]] = {}
        for one in (one for one in held if one.whole or other == lags):
            theirs, ours = one.responses[other].losses, one.responses[best].losses
            difference = theirs[:, k] - ours[:, k]
            pieces.setdefault(one.piece, []).append(difference)
        differences = [np.concatenate(each) for each in pieces.values()]
        tied = not clearly_less([-each for each in differences])
        ratios = 0.5 * np.log(errors[:, other] / errors[:, best])
        lower = other == lags and tied and surely_below(ratios)
        if lower or clearly_less(differences):
            best = other
    return best


def error_products(held: Sequence[HeldOut], k: int, *, high_pass: bool = True) -> FloatArray:
    """Mean products (pieces, models, models) of the errors in output `k`, behind the high pass.

    Pieces without a measured sample are left out; a model that has no free run is NaN.
    """
    sums: dict[str, FloatArray] = {}
    counts: dict[str, int] = {}
    for one in held:
        errors = (one.models - one.measured)[:, :, k]
        errors = errors[:, np.isfinite(one.measured[:, k])]
        errors = _high_passed(errors, one.dt_s) if high_pass else errors
        sums[one.piece] = sums.get(one.piece, 0.0) + errors @ errors.T
        counts[one.piece] = counts.get(one.piece, 0) + errors.shape[1]
    found = [sums[piece] / count for piece, count in counts.items() if count]
    return np.array(found).reshape(len(found), len(MODELS), len(MODELS))


def _high_passed(errors: FloatArray, dt_s: float) -> FloatArray:
    """Errors (models, time) less their first-order lag, which starts settled."""
    if not errors.shape[1]:
        return errors
    stays = np.exp(-dt_s / _MOVES_S)
    slow, _ = lfilter([1.0 - stays], [1.0, -stays], errors, zi=stays * errors[:, :1])
    return np.asarray(errors - slow)


def weights_of(products: FloatArray, fitted: BoolArray | None = None) -> FloatArray:
    """Weights (models,) by mean products of errors (pieces, models, models); see the module.

    A model without a free run over some piece has none, nor one that is not among those `fitted`
    (models,) to all logs. Without any model that has one the network is alone.
    """
    usable = np.isfinite(np.diagonal(products, axis1=1, axis2=2)).all(axis=0)
    usable = usable if fitted is None else usable & fitted
    weights = np.zeros(products.shape[1])
    if not usable.any():
        weights[0] = 1.0
        return weights
    simple = usable & np.isin(MODELS, SIMPLE)
    if len(products) < 2 and simple.any():
        return np.asarray(simple / simple.sum())
    prior = np.full(int(usable.sum()), 1.0 / usable.sum())
    if not len(products):
        weights[usable] = prior
        return weights
    known = products[:, usable][:, :, usable]
    floor = _LEAST_ERROR**2 * max(float(known.max()), 1e-300)
    known = known + floor * np.eye(known.shape[1])
    leader = _leader(known, prior)
    found = _stacked(known, prior) if leader is None else np.eye(known.shape[1])[leader]
    found = np.where(found < _LEAST_WEIGHT, 0.0, found)
    weights[usable] = found / found.sum()
    return weights


def _leader(products: FloatArray, prior: FloatArray) -> int | None:
    """The model that is clearly better than each other one and than their mixture, if any."""
    pieces, models = products.shape[:2]
    if models == 1:
        return 0
    if pieces < 2:
        return None
    logs = 0.5 * np.log(np.diagonal(products, axis1=1, axis2=2))
    mixed = np.empty(pieces)
    for r in range(pieces):
        w = _stacked(np.delete(products, r, axis=0), prior)
        mixed[r] = 0.5 * np.log(w @ products[r] @ w)
    best = int(np.argmin(logs.mean(axis=0)))
    others = np.column_stack([np.delete(logs, best, axis=1), mixed])
    return best if surely_below(logs[:, best, None] - others).all() else None


def _stacked(products: FloatArray, prior: FloatArray) -> FloatArray:
    """Weights (models,) that minimise the module's sum, from the prior's and from each model."""
    models = products.shape[1]
    size = np.exp(np.log(np.diagonal(products, axis1=1, axis2=2)).mean(axis=1))
    scaled = products / size[:, None, None]

    def loss(logs: FloatArray) -> tuple[float, FloatArray]:
        w = np.exp(logs - logs.max())
        w /= w.sum()
        ahead = scaled @ w
        square = np.maximum(ahead @ w, 1e-300)
        slope = (ahead / square[:, None]).sum(axis=0) - _PRIOR * prior / w
        value = 0.5 * np.log(square).sum() - _PRIOR * (prior @ np.log(w))
        return float(value), w * (slope - slope @ w)

    starts = [np.log(prior), *(0.25 * _FAR * np.eye(models))]
    bounds = [(-_FAR, _FAR)] * models
    tried = [minimize(loss, x, jac=True, method="L-BFGS-B", bounds=bounds) for x in starts]
    best = min(tried, key=lambda one: float(one.fun)).x
    w = np.exp(best - best.max())
    return np.asarray(w / w.sum())


def _known(values: Sequence[FloatArray]) -> list[float]:
    return [float(value) for value in np.concatenate(values) if np.isfinite(value)]
