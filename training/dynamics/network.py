"""Train a NARX network in free run: several starts, growing horizons, the best one kept.

The loop takes steps from any optimiser. Its `TrainingState` can be written to disk after every
step and resumed, with the same path as without an interruption. Training starts from a stable
linear model: the open-loop least-squares ARX model is one candidate; first-order lags are the
others, since the ARX fit of a smooth recording is often an integrator that a free run cannot use.
`merge_models` joins networks of one output each into one that computes the same.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from narxcal.narx.config import NarxConfig
from narxcal.narx.network import NarxModel, Scaling, Weights, tap
from narxcal.record import Record, check_measured, check_records
from narxcal.support.arrays import FloatArray
from narxcal.support.files import finite
from narxcal.support.interrupt import Interrupt, held_interrupt
from training.config import TrainConfig
from training.dynamics.free_run import FreeRunProblem, cut_windows
from training.dynamics.optimisers import Damping, Moments, adam, minimise

_POLES = (0.0, 0.5, 0.8, 0.9, 0.95, 0.98, 0.995)
_RIDGE = 1e-6

if TYPE_CHECKING:
    from narxcal.narx.module import NarxNet


def net_of(model: NarxModel) -> NarxNet:
    """Return the network as a PyTorch module, from then on the one that `model` runs."""
    from narxcal.narx.module import NarxNet  # noqa: PLC0415 (PyTorch takes seconds to import)

    if not isinstance(model.network, NarxNet):
        model.network = NarxNet.of(model.weights)
    return model.network


def new_model(
    records: Sequence[Record],
    config: NarxConfig,
    seed: int,
    least_scale: FloatArray | float = 0.0,
) -> NarxModel:
    """Scale to the records, bound to their envelope, draw the hidden layer, silence the output.

    Deviations and increments are zero at rest, so an anchored network scales without centring.
    """
    from narxcal.narx.module import NarxNet  # noqa: PLC0415 (PyTorch takes seconds to import)

    u = np.concatenate([record.u for record in records])
    y = np.concatenate([record.y for record in records])
    outputs = Scaling.of(y, centred=not config.moving)
    inputs = Scaling.of(u)
    inputs = replace(inputs, scale=np.maximum(inputs.scale, least_scale))
    inputs.centre[: config.moving] = 0.0
    low, high = np.nanmin(y, axis=0), np.nanmax(y, axis=0)
    if config.moving:
        low, high = np.minimum(low, 0.0), np.maximum(high, 0.0)
    margin = config.margin * np.maximum(high - low, 1e-9)
    drawn = NarxNet.drawn(config, (u.shape[1], y.shape[1]), seed).weights()
    weights = replace(
        drawn,
        w2=np.zeros_like(drawn.w2),
        b2=np.zeros_like(drawn.b2),
        a=np.zeros_like(drawn.a),
        low=outputs.down(low - margin),
        high=outputs.down(high + margin),
    )
    return NarxModel(weights, inputs, outputs)


def start_linear(model: NarxModel, records: Sequence[Record], problem: FreeRunProblem) -> None:
    """Give the linear path of `model` the candidate with the least free-run loss."""
    drawn = model.weights
    thetas = [
        replace(drawn, a=linear, b2=bias).theta for linear, bias in _candidates(model, records)
    ]
    losses = [problem.loss(theta) for theta in thetas]
    net_of(model).set_theta(thetas[int(np.argmin(losses))])


def _candidates(model: NarxModel, records: Sequence[Record]) -> list[tuple[FloatArray, FloatArray]]:
    phi, target = _regression(model, records)
    arx = _least_squares(phi, target, model.config.moving > 0)
    found = [arx]
    outputs = model.outputs
    for pole in _POLES:
        lagged = target - pole * phi[:, :outputs]
        rest = phi.copy()
        rest[:, : model.config.lags * outputs] = 0.0
        linear, bias = _least_squares(rest, lagged, model.config.moving > 0)
        linear[:, :outputs] = pole * np.eye(outputs)
        found.append((linear, bias))
    return found


def _regression(model: NarxModel, records: Sequence[Record]) -> tuple[FloatArray, FloatArray]:
    """Phi (n, f) and the next outputs (n, o) of all records; moving inputs alone if anchored."""
    moving, parts = model.config.moving, []
    for record in records:
        u, y = model.input_scaling.down(record.u), model.output_scaling.down(record.y)
        if moving:
            u = np.where(np.arange(u.shape[1]) < moving, u, 0.0)
        parts.append(regression(u, y, model.config.lags, model.config.taps))
    phi, target = zip(*parts, strict=True)
    return np.concatenate(phi), np.concatenate(target)


def regression(
    u: FloatArray, y: FloatArray, lags: int, taps: Sequence[int]
) -> tuple[FloatArray, FloatArray]:
    """Past outputs, newest first, and tapped inputs (n, f), and the outputs (n, o) that follow.

    Rows with an unknown value are left out, and those without a whole past.
    """
    rows = np.arange(min(lags, len(y)), len(y))
    past = [y[rows - i] for i in range(1, lags + 1)]
    phi = np.concatenate([*past, tap(u, taps)[rows]], axis=1)
    known = np.isfinite(phi).all(axis=1) & np.isfinite(y[rows]).all(axis=1)
    return phi[known], y[rows][known]


def _least_squares(
    phi: FloatArray, target: FloatArray, anchored: bool
) -> tuple[FloatArray, FloatArray]:
    ones = np.zeros((len(phi), 1)) if anchored else np.ones((len(phi), 1))
    matrix = np.concatenate([phi, ones], axis=1)
    # Without a row whose history is known the ridge alone decides: all zero.
    normal = matrix.T @ matrix + _RIDGE * max(len(phi), 1) * np.eye(matrix.shape[1])
    solution = np.linalg.solve(normal, matrix.T @ target).T
    return np.ascontiguousarray(solution[:, :-1]), solution[:, -1].copy()


@dataclass(frozen=True)
class HistoryRow:
    """One training step: where it was taken and the losses after it.

    `validation` is the root of twice the free-run loss on whole validation records in scaled
    units (NaN without validation records).
    """

    start: int
    stage: int
    horizon_s: float
    iteration: int
    loss: float
    validation: float


@dataclass(frozen=True, eq=False)
class TrainingState:
    """Where training stands after a step, complete: theta, optimiser state, the best so far."""

    theta: FloatArray
    start: int = 0
    stage: int = 0
    iteration: int = 0
    damping: Damping = field(default_factory=Damping)
    moments: Moments | None = None
    best_theta: FloatArray | None = None
    best_score: float = float("inf")
    since_best: int = 0
    history: tuple[HistoryRow, ...] = ()


# After every step, to show progress or write a checkpoint; True ends the training there.
OnStep = Callable[[TrainingState], bool | None]


@dataclass(frozen=True, eq=False)
class FitResult:
    """The trained model, how it ended in words, and every step on the way."""

    model: NarxModel
    status: str
    score: float
    history: tuple[HistoryRow, ...]

    def to_arrays(self) -> tuple[dict[str, Any], dict[str, Any], dict[str, FloatArray]]:
        """Split into the structure of the model and the result, both JSON-able, and arrays."""
        network, arrays = self.model.to_arrays()
        history = [asdict(row) for row in self.history]
        result = {"status": self.status, "score": self.score, "history": history}
        return network, finite(result), arrays

    @classmethod
    def from_arrays(
        cls,
        network: Mapping[str, Any],
        result: Mapping[str, Any],
        arrays: Mapping[str, FloatArray],
    ) -> Self:
        return cls(
            model=NarxModel.from_arrays(network, arrays),
            status=result["status"],
            score=known_numbers(result)["score"],
            history=tuple(HistoryRow(**known_numbers(row)) for row in result["history"]),
        )


def known_numbers(row: Mapping[str, Any]) -> dict[str, Any]:
    """The values of a JSON document, NaN where it has null: JSON has no NaN."""
    return {key: np.nan if value is None else value for key, value in row.items()}


@dataclass(frozen=True, eq=False)
class Material:
    """What to learn from: training records, validation records (may be none), their interval.

    `rest` records (see training.records) teach the return to rest. They only make sense whole, so
    they take part where the horizon holds them. Inputs are divided by their standard deviations, or
    by `least_scale` (inputs,) where that is larger.
    """

    records: Sequence[Record]
    validation: Sequence[Record]
    dt_s: float
    rest: Sequence[Record] = ()
    least_scale: FloatArray | float = 0.0

    def of_output(self, k: int) -> Material:
        records, validation, rest = (
            [Record(each.u, each.y[:, k : k + 1], each.name, each.weight) for each in part]
            for part in (self.records, self.validation, self.rest)
        )
        return replace(self, records=records, validation=validation, rest=rest)

    def within(self, horizon_s: float) -> list[Record]:
        """Training records, with the rest records that fit into `horizon_s` (0: any)."""
        steps = horizon_s / self.dt_s if horizon_s > 0 else float("inf")
        return [*self.records, *(record for record in self.rest if len(record) <= steps)]


def fit_narx(
    material: Material,
    structure: NarxConfig,
    config: TrainConfig,
    on_step: OnStep | None = None,
    resume: TrainingState | None = None,
) -> FitResult:
    """Train on whole records in free run; the same seed gives the same network.

    Ctrl-C ends the training after the step it is in and keeps the best network so far. Raises
    `DataError` for records that do not fit each other, are too short or lack an output throughout.
    """
    check_records([*material.records, *material.validation], structure.lags + structure.taps[-1])
    check_measured(material.records, "training")
    if material.validation:
        check_measured(material.validation, "validation")
    run = _Run(material, structure, config, on_step or (lambda _state: None))
    progress = resume or TrainingState(run.first_theta(0))
    status = "all steps done"
    try:
        with held_interrupt() as interrupt:
            run.train(progress, interrupt)
    except KeyboardInterrupt:
        status = "interrupted: the best network so far was kept; --resume goes on from here"
    progress = run.latest or progress
    theta = progress.theta if progress.best_theta is None else progress.best_theta
    net_of(run.model).set_theta(theta)
    return FitResult(run.model, status, progress.best_score, progress.history)


class _Run:
    """One call of `fit_narx`: the fixed things, and the loop over starts and stages."""

    def __init__(
        self, material: Material, structure: NarxConfig, config: TrainConfig, on_step: OnStep
    ) -> None:
        self.material = material
        self.config = config
        self.on_step = on_step
        self.structure = structure
        self.latest: TrainingState | None = None
        self.model = self._new(config.seed)
        self.judge = self._problem(material.validation or material.records, 0.0)

    def _new(self, seed: int) -> NarxModel:
        material = self.material
        return new_model(material.records, self.structure, seed, material.least_scale)

    def _problem(self, records: Sequence[Record], horizon_s: float) -> FreeRunProblem:
        dt_s = self.material.dt_s
        horizon = max(round(horizon_s / dt_s), 1) if horizon_s > 0 else None
        stride = max(round(self.config.score_every_s / dt_s), 1)
        windows = cut_windows(self.model, records, horizon, stride, self.config.restarts)
        return FreeRunProblem(net_of(self.model), windows, self.config.threads)

    def first_theta(self, start: int) -> FloatArray:
        """Weights that start number `start` begins with."""
        drawn = self._new(self.config.seed + start)
        net_of(self.model).set_theta(net_of(drawn).get_theta())
        problem = self._problem(self.material.records, self.config.horizons_s[0])
        start_linear(self.model, self.material.records, problem)
        return net_of(self.model).get_theta()

    def train(self, progress: TrainingState, interrupt: Interrupt) -> None:
        """Go on from `progress` to the end; `latest` always holds the last complete step."""
        while progress.start < self.config.starts:
            while progress.stage < len(self.config.horizons_s):
                for after in self._stage(progress):
                    progress = self.latest = after
                    if self.on_step(progress):
                        return
                    interrupt.stop_here()
                progress = self.latest = self._settle(progress)
            start = progress.start + 1
            if start < self.config.starts:
                progress = replace(progress, theta=self.first_theta(start))
            progress = self.latest = replace(progress, start=start, stage=0)
        self.on_step(progress)

    def _stage(self, progress: TrainingState) -> Iterator[TrainingState]:
        """Yield the progress after each step of one horizon."""
        horizon_s = self.config.horizons_s[progress.stage]
        if self._over(progress):
            return
        problem = self._problem(self.material.within(horizon_s), horizon_s)
        for stepped, loss in self._optimise(problem, progress):
            progress = replace(
                progress,
                theta=stepped.theta,
                damping=stepped.damping,
                moments=stepped.moments,
                iteration=progress.iteration + 1,
            )
            progress = self._scored(progress, loss, horizon_s)
            yield progress
            if self._over(progress):
                return

    def _over(self, progress: TrainingState) -> bool:
        tired = bool(self.material.validation) and progress.since_best >= self.config.patience
        return tired or progress.iteration >= self.config.iterations[progress.stage]

    def _optimise(
        self, problem: FreeRunProblem, progress: TrainingState
    ) -> Iterator[tuple[TrainingState, float]]:
        """Yield (`progress` with new theta and optimiser's state, loss) for any optimiser."""
        theta, decay = progress.theta, self.config.decay
        if self.config.optimiser == "adam":
            rate = self.config.rate
            for move in adam(problem, theta, rate, decay, progress.moments):
                yield replace(progress, theta=move.theta, moments=move.moments), move.loss
            return
        for step in minimise(problem, theta, decay, progress.damping):
            yield replace(progress, theta=step.theta, damping=step.damping), step.loss

    def _scored(self, progress: TrainingState, loss: float, horizon_s: float) -> TrainingState:
        """Add the history row; with validation records, keep the best step by them."""
        validation = float("nan")
        if self.material.validation:
            validation = float(np.sqrt(2.0 * self.judge.loss(progress.theta)))
            progress = _keep(progress, validation)
        row = HistoryRow(
            progress.start, progress.stage, horizon_s, progress.iteration, loss, validation
        )
        return replace(progress, history=(*progress.history, row))

    def _settle(self, progress: TrainingState) -> TrainingState:
        """End a stage; without validation records, its last step competes by its own free run."""
        last = progress.stage + 1 == len(self.config.horizons_s)
        if last and not self.material.validation:
            own = float(np.sqrt(2.0 * self.judge.loss(progress.theta)))
            progress = _keep(progress, own)
        return replace(
            progress,
            stage=progress.stage + 1,
            iteration=0,
            since_best=0,
            damping=Damping(),
            moments=None,
        )


def _keep(progress: TrainingState, score: float) -> TrainingState:
    if score < progress.best_score:
        return replace(progress, best_theta=progress.theta, best_score=score, since_best=0)
    return replace(progress, since_best=progress.since_best + 1)


def merge_models(models: Sequence[NarxModel]) -> NarxModel:
    """Join single-output networks over the same inputs side by side.

    Weights between their parts are zero, so every output is exactly what it was alone. One
    model alone is returned as it is.
    """
    if len(models) == 1:
        return models[0]
    first, count = models[0], len(models)
    config = first.config.model_copy(update={"hidden": first.config.hidden * count})
    parts = [model.weights for model in models]
    units, fed = first.config.hidden, first.config.lags
    width = first.config.lags * count + parts[0].w1.shape[1] - fed
    w1, w2 = np.zeros((units * count, width)), np.zeros((count, units * count))
    a = np.zeros((count, width))
    for k, part in enumerate(parts):
        rows, past = slice(k * units, (k + 1) * units), np.arange(fed) * count + k
        w1[rows, past], w1[rows, fed * count :] = part.w1[:, :fed], part.w1[:, fed:]
        a[k, past], a[k, fed * count :] = part.a[0, :fed], part.a[0, fed:]
        w2[k, rows] = part.w2[0]
    weights = Weights(
        config=config,
        w1=w1,
        w2=w2,
        a=a,
        **{
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in ("b1", "b2", "low", "high")
        },
    )
    scales = [model.output_scaling for model in models]
    outputs = Scaling(
        np.concatenate([scale.centre for scale in scales]),
        np.concatenate([scale.scale for scale in scales]),
    )
    return NarxModel(weights, first.input_scaling, outputs)
