"""`Narx`: a scikit-learn estimator for any records.

`Narx.save` writes a folder of `narx.json`,

    schema      "narxcal.narx/1" of a network, "narxcal.narx/2" of a chosen form
    parameters  structure, train, dt_s, and of /2 time_limit_s and seed, as given; null or "auto"
                for what was left to the default
    network     structure and sizes of the trained model
    result      how the training ended: status, score, every step; of /2 status, rung, reason,
                work and everything that was tried; inputs and outputs, names of the columns
    weights     file, SHA-256, shapes; the arrays themselves are in that file
    sha256      of parameters, network and result
    versions    of Python and the packages that made it

and `weights.safetensors`. A number that is not finite, such as a validation error without
validation records, is null.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from numbers import Real
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self, TypeAlias, TypeGuard, overload

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from rich.progress import Progress
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.exceptions import NotFittedError

from narxcal.calibration.folder import WEIGHTS, ModelFolder, packed, seal
from narxcal.intervals import Band
from narxcal.narx.config import NarxConfig
from narxcal.narx.forms import DynamicModel, from_rest
from narxcal.narx.network import checked_inputs, checked_start
from narxcal.record import (
    Record,
    RecordLike,
    as_records,
    by_name,
    check_measured,
    check_records,
    columns,
    known_start,
)
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError, DataError, ModelError
from narxcal.support.files import (
    Results,
    atomic_folder,
    atomic_write_bytes,
    atomic_write_text,
    to_json,
    versions,
)
from narxcal.support.settings import Section
from training.config import TrainConfig
from training.dynamics.network import FitResult, Material, OnStep, fit_narx
from training.estimator.ladder import TIME_LIMIT_S, Choice, Limits, choose

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Records: TypeAlias = RecordLike | Iterable[RecordLike]
Arrays: TypeAlias = NDArray[Any] | pd.DataFrame | pd.Series
Structure: TypeAlias = NarxConfig | Literal["auto"] | None

# Default for unknown records. On held-back stretches of the training ranges of three public sets
# (`python -m eval.bench`), eight lags have 0.5 to 0.9 times the error of two or four.
_STRUCTURE = NarxConfig(lags=8, taps=tuple(range(9)), hidden=8)
# Horizons in samples.
_TRAIN = TrainConfig(horizons_s=(20.0, 200.0, 0.0), iterations=(10, 20, 40), score_every_s=1.0)
_DEFAULTS: dict[str, Section] = {"structure": _STRUCTURE, "train": _TRAIN}
_NETWORK, _CHOSEN = "narxcal.narx/1", "narxcal.narx/2"
_FORM = ModelFolder(
    what="stored Narx",
    document="narx.json",
    schemas=(_NETWORK, _CHOSEN),
    made_by="Narx.save",
    again="Copy the folder again, or train anew",
)
_SEALED = ("parameters", "network", "result")
# What a document of unforeseen types and values raises where it is taken apart.
_UNREADABLE = (
    LookupError, TypeError, ValueError, AttributeError, ArithmeticError, RecursionError,
    ConfigError,
)  # fmt: skip


class NotTrainedError(ModelError, NotFittedError):  # type: ignore[misc]  # scikit-learn ships no types
    """The network is not trained yet; also scikit-learn's `NotFittedError`."""


class Narx(RegressorMixin, BaseEstimator):  # type: ignore[misc]  # likewise
    """Model of a dynamic system, fitted to its free run over one or several records.

    With `structure="auto"` (and no `train`) the form is chosen by held-out free runs, from a
    first-order lag to a network with latent states (see `training.estimator.ladder`): `choice_`
    lists what was tried, `reason_` says in a sentence why, `status_` how the search ended.
    `time_limit_s` is processor time, kept to about a second: what was found until then is returned.
    Work is counted in steps, so that the same records and `seed` give the same model, unless the
    clock shortened the search, which `status_` says. `verbose` shows a progress bar.

    A `NarxConfig` is the NARX network of this structure: lags, input taps and width; `train` holds
    the optimiser and its horizons (in the unit of `dt_s`, which is 1 by default: then horizons
    count samples). Tap 0 is the input at the predicted sample itself; leave it out where that must
    not be used. `None`, or "auto" with a `train`, is 8 lags, taps 0 to 8 and 8 hidden units.

    `fit(X, y)`, `predict(X)` and `score(X, y)` take one recording as scikit-learn's estimators do:
    X (time, inputs) and y (time,) or (time, outputs), rows in the order of time
    (`TimeSeriesSplit`). Several are a list of records: pairs of such arrays or `Record`, which also
    has a name; `fit(records)` and `score(records)` then have no y. Data frames are taken by the
    column names of the first record of `fit`, `input_names_` and `output_names_`; a name that is
    missing or unknown is a `DataError`. Searches reach into both sections:
    `GridSearchCV(Narx(), {"structure__hidden": [4, 8]}, cv=TimeSeriesSplit())`. `save` and
    `Narx.load` keep a trained one in a folder.

    >>> import numpy as np
    >>> u = np.sin(0.3 * np.arange(300)) + np.cos(0.05 * np.arange(300) ** 1.2)
    >>> y = np.zeros(300)
    >>> for k in range(1, 300):
    ...     y[k] = 0.8 * y[k - 1] + 0.2 * np.tanh(2.0 * u[k - 1])
    >>> model = Narx(NarxConfig(lags=1, taps=(1,), hidden=4)).fit(u, y)
    >>> bool(model.score(u, y) > 0.999)
    True
    """

    input_names_: tuple[str, ...] = ()
    output_names_: tuple[str, ...] = ()

    def __init__(  # noqa: PLR0913 (scikit-learn wants all settings here)
        self,
        structure: Structure = "auto",
        train: TrainConfig | None = None,
        dt_s: float = 1.0,
        *,
        time_limit_s: float = TIME_LIMIT_S,
        seed: int = 0,
        verbose: bool = False,
    ) -> None:
        self.structure = structure
        self.train = train
        self.dt_s = dt_s
        self.time_limit_s = time_limit_s
        self.seed = seed
        self.verbose = verbose

    def fit(
        self,
        X: Records | Arrays,
        y: ArrayLike | None = None,
        validation: Records | None = None,
        on_step: OnStep | None = None,
    ) -> Self:
        """Fit to records, or to X and y; stop and select by `validation` records where given.

        `on_step` is called after every step of a network. NaN outputs are masked. Raises
        `DataError` for what is no record, and for records that do not fit each other,
        `ConfigError` for parameters that are none.
        """
        structure, train = self._sections()
        self._check_numbers()
        learned = _recorded(X, y)
        names = (learned[0].inputs, learned[0].outputs) if learned else ((), ())
        held_out = [] if validation is None else as_records(validation, "validation record", names)
        self.result_: FitResult | Choice
        if _is_auto(self.structure) and self.train is None:
            self.result_ = self._chosen(learned, held_out)
        else:
            material = Material(learned, held_out, self.dt_s)
            self.result_ = fit_narx(material, structure, train, on_step)
        self.input_names_, self.output_names_ = names
        return self

    def _check_numbers(self) -> None:
        for key in ("dt_s", "time_limit_s"):
            value = getattr(self, key)
            if not (_is_number(value) and 0.0 < value < np.inf):
                raise ConfigError(f"key '{key}': expected a time above 0, found {value!r}")
        if not (
            isinstance(self.seed, int | np.integer) and _is_number(self.seed) and self.seed >= 0
        ):
            raise ConfigError(f"key 'seed': expected an integer of at least 0, found {self.seed!r}")

    def _chosen(self, learned: list[Record], held_out: list[Record]) -> Choice:
        check_records([*learned, *held_out], 0)
        check_measured(learned, "training")
        limits = Limits(self.time_limit_s, self.seed)
        if not self.verbose:
            return choose(learned, limits, validation=held_out)
        with Progress(transient=True) as bar:
            task = bar.add_task("choosing", total=100)

            def show(done: int, total: int, what: str = "") -> None:
                bar.update(task, completed=done, total=total, description=what)

            return choose(learned, limits, show, held_out)

    @property
    def n_features_in_(self) -> int:
        """Number of inputs, as scikit-learn calls it."""
        return self.model.inputs

    @property
    def model(self) -> DynamicModel:
        """The fitted model; raises `NotTrainedError` before `fit`."""
        return self._fitted().model

    @property
    def choice_(self) -> pd.DataFrame:
        """Everything that was tried, best first: rung, form, score, standard_error, chosen."""
        return self._choice().tried

    @property
    def reason_(self) -> str:
        """One sentence that says why this form was chosen."""
        return self._choice().reason

    @property
    def status_(self) -> str:
        """How fitting ended."""
        return self._fitted().status

    def _fitted(self) -> FitResult | Choice:
        if not hasattr(self, "result_"):
            raise NotTrainedError("the NARX network is not trained yet", hint="Call fit first")
        return self.result_

    def _choice(self) -> Choice:
        found = self._fitted()
        if not isinstance(found, Choice):
            raise ModelError("the structure was given, so nothing was chosen")
        return found

    def save(self, folder: str | PathLike[str], *, replace: bool = False) -> None:
        """Write the trained model and all parameters to a new folder, without pickle.

        Raises `NotTrainedError` before `fit`, and `ConfigError` for a folder that has content (with
        `replace`, other than a stored `Narx`) or cannot be written.
        """
        self._sections()
        found = self._fitted()
        network, result, arrays = found.to_arrays()
        parameters: dict[str, Any] = {
            "structure": _dumped(self.structure),
            "train": _dumped(self.train),
            "dt_s": float(self.dt_s),
        }
        if isinstance(found, Choice):
            parameters |= {"time_limit_s": float(self.time_limit_s), "seed": int(self.seed)}
        names = {"inputs": list(self.input_names_), "outputs": list(self.output_names_)}
        sealed = {"parameters": parameters, "network": network, "result": result | names}
        weights, entry = packed(arrays)
        document = {
            "schema": _CHOSEN if isinstance(found, Choice) else _NETWORK,
            **sealed,
            "sha256": seal(json.loads(json.dumps(sealed))),
            "weights": entry,
            "versions": versions(),
        }
        content = Results("narxcal.narx/", _FORM.document, (WEIGHTS,))
        with atomic_folder(folder, content if replace else None) as part:
            atomic_write_bytes(part / WEIGHTS, weights)
            atomic_write_text(part / _FORM.document, to_json(document))

    @classmethod
    def load(cls, folder: str | PathLike[str]) -> Self:
        """Read what `save` wrote: the same parameters, and a model that computes the same.

        Raises `ModelError` for a folder that is another, damaged or altered.
        """
        source = Path(folder)
        document = _FORM.read_document(source)
        arrays = _FORM.read_arrays(source, document)
        sealed = {key: _FORM.part(source, document, key) for key in _SEALED}
        file = source / _FORM.document
        if seal(sealed) != document.get("sha256"):
            problem = f"{', '.join(_SEALED[:-1])} or {_SEALED[-1]} were altered"
            raise ModelError(problem, file=file, hint=_FORM.again)
        kind: type[Choice | FitResult] = Choice if document["schema"] == _CHOSEN else FitResult
        try:
            loaded = cls(**_parameters(sealed["parameters"]))
            result = sealed["result"]
            loaded.result_ = kind.from_arrays(sealed["network"], result, arrays)
            loaded.input_names_ = tuple(result.get("inputs", ()))
            loaded.output_names_ = tuple(result.get("outputs", ()))
        except _UNREADABLE as error:
            problem = f"a part cannot be read: {error}"
            raise ModelError(problem, file=file, hint=_FORM.again) from None
        return loaded

    @overload
    def simulate(self, u: ArrayLike, start: ArrayLike) -> FloatArray: ...
    @overload
    def simulate(self, u: ArrayLike, start: ArrayLike, interval: float) -> Band: ...
    def simulate(
        self, u: ArrayLike, start: ArrayLike, interval: float | None = None
    ) -> FloatArray | Band:
        """Free run (time, outputs) over `u` (time, inputs); `start` are its first n samples.

        `start` is (n, outputs); of one dimension it is (n,) where there is one output, and one
        sample (outputs,) where there are several. With `interval`, such as 0.9, a `Band` that
        covers this share of samples, by the errors of held-out free runs at the same horizon.
        """
        model = self.model
        inputs = checked_inputs(columns(by_name(u, self.input_names_)), model.inputs)
        start = by_name(start, self.output_names_)
        first = checked_start(columns(start) if model.outputs == 1 else start, model.outputs)
        if len(first) >= len(inputs):
            raise DataError(
                f"the start of {len(first)} samples covers all {len(inputs)} of the inputs, so "
                "nothing is simulated",
                hint="Give the first k samples, or `predict` for one step",
            )
        free_run = model.simulate(inputs, first)
        if interval is None:
            return free_run
        if not 0.0 < interval < 1.0:
            raise DataError(f"expected an interval between 0 and 1, found {interval}")
        found = self._fitted()
        if not isinstance(found, Choice) or found.intervals.pieces == 0:
            raise ModelError(
                "nothing was held out, so there is no interval", hint='Use structure="auto"'
            )
        half = np.zeros_like(free_run)
        steps = len(free_run) - len(first)
        half[len(free_run) - steps :] = found.intervals.half_width(steps, interval)
        return Band(free_run, free_run - half, free_run + half)

    def predict(self, u: ArrayLike, y: ArrayLike | None = None, *, steps: int = 1) -> FloatArray:
        """Prediction `steps` ahead (time, outputs) from measured outputs `y` (time, outputs).

        Without `y` it is the free run from the equilibrium at the first input: (time,) where there
        is one output, as scikit-learn expects.
        """
        model = self.model
        inputs = checked_inputs(columns(by_name(u, self.input_names_)), model.inputs)
        if y is None:
            free_run = from_rest(model, inputs)
            return free_run[:, 0] if model.outputs == 1 else free_run
        if steps < 1:
            raise DataError(f"expected a prediction of at least one step, found steps = {steps}")
        measured = columns(by_name(y, self.output_names_))
        if measured.shape != (len(inputs), model.outputs):
            raise DataError(
                f"expected outputs of shape {(len(inputs), model.outputs)}, found {measured.shape}"
            )
        return model.predict(inputs, measured, steps)

    def score(self, X: Records | Arrays, y: ArrayLike | None = None, *, start: int = 1) -> float:
        """Coefficient of determination of the free run, pooled over records and outputs.

        Where the outputs never vary it is 1 for a free run without error, else 0.

        The first `start` measured samples of each record initialise it and are not scored; one
        that is masked takes the channel's first known value. Raises `DataError` for records that
        the model or `start` does not fit, and for one in which an output is masked throughout.
        """
        error, spread = 0.0, 0.0
        for record in self._scorable(X, y, start):
            free_run = self.model.simulate(record.u, known_start(record.y, start))
            scored = slice(start, None)
            centre = np.nanmean(record.y, axis=0)
            error += float(np.nansum((free_run[scored] - record.y[scored]) ** 2))
            spread += float(np.nansum((record.y[scored] - centre) ** 2))
        if spread == 0.0:  # as scikit-learn scores what never varies
            return 1.0 if error == 0.0 else 0.0
        return 1.0 - error / spread

    def _scorable(self, X: Records | Arrays, y: ArrayLike | None, start: int) -> list[Record]:
        if start < 1:
            raise DataError(f"expected at least one start sample, found start = {start}")
        net = self.model
        records = _recorded(X, y, (self.input_names_, self.output_names_))
        found = check_records(records, start)
        if found != (net.inputs, net.outputs):
            raise DataError(
                f"expected {net.inputs} inputs and {net.outputs} outputs as in training, "
                f"found {found[0]} and {found[1]}",
                file=records[0].name,
            )
        for record in records:
            known = np.isfinite(record.y).any(axis=0)
            if not np.all(known):
                raise DataError(
                    f"output {int(np.argmin(known)) + 1} of {net.outputs} has no known sample that "
                    "a free run could start from",
                    file=record.name,
                    hint="Leave this record out, or fill its first sample",
                )
        return records

    def plot(
        self, record: RecordLike, channel: str | None = None, *, ax: Axes | None = None
    ) -> Axes:
        """Draw an output of a record as measured and in free run, with its fit in percent.

        As `narxcal.plot.compare(record, self, channel)`; raises `DataError` as that does.
        """
        from eval.report import plot  # noqa: PLC0415 - declared to import-linter; fits draw nothing

        return plot.compare(record, self, channel, ax=ax)

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Settings by name; if `deep`, the keys of both sections too, as `structure__hidden`."""
        params: dict[str, Any] = super().get_params(deep=False)
        if deep:
            for name in _DEFAULTS:
                section = self._defaulted(name)
                if isinstance(section, Section):  # anything may be set; `fit` judges
                    params |= {f"{name}__{key}": value for key, value in section}
        return params

    def set_params(self, **params: Any) -> Self:
        """Set parameters by the names of `get_params`.

        Raises `ConfigError` for a bad key or value of a section, `ValueError` for a strange name.
        """
        own: dict[str, Any] = {}
        nested: dict[str, dict[str, Any]] = {name: {} for name in _DEFAULTS}
        for name, value in params.items():
            head, _, key = name.partition("__")
            if key and head in nested:
                nested[head][key] = value
            else:
                own[name] = value
        super().set_params(**own)
        for name in (name for name in _DEFAULTS if nested[name]):
            section = self._section(name)
            setattr(self, name, type(section).parse(dict(section) | nested[name]))
        return self

    def _sections(self) -> tuple[NarxConfig, TrainConfig]:
        return self._section("structure"), self._section("train")

    def _section(self, name: str) -> Any:
        default, given = _DEFAULTS[name], self._defaulted(name)
        if not isinstance(given, type(default)):
            kind = type(default).__name__
            raise ConfigError(
                f"key '{name}': expected {kind}, found {type(given).__name__}",
                hint=f"Pass {kind}(...)",
            )
        return given

    def _defaulted(self, name: str) -> Any:
        """A parameter as `fit` takes it, of whatever type."""
        given = getattr(self, name)
        left = given is None or (name == "structure" and _is_auto(given))
        return _DEFAULTS[name] if left else given


def _recorded(
    X: Any, y: ArrayLike | None, like: tuple[Sequence[str], Sequence[str]] = ((), ())
) -> list[Record]:
    """Records as such, or the one of plain arrays X and y."""
    return as_records(X if y is None else [(X, y)], like=like)


def _is_auto(structure: object) -> bool:
    return isinstance(structure, str) and structure == "auto"


def _is_number(value: object) -> TypeGuard[Any]:
    return isinstance(value, Real) and not isinstance(value, bool)


def _dumped(section: Structure | TrainConfig) -> dict[str, Any] | str | None:
    if section is None or isinstance(section, str):
        return section
    return section.model_dump(mode="json", by_alias=True)


def _parameters(stored: Mapping[str, Any]) -> dict[str, Any]:
    """Arguments of `Narx` from `narx.json`."""
    structure, train = stored["structure"], stored["train"]
    if structure is not None and structure != "auto":
        structure = NarxConfig.parse(structure)
    known = {key: stored[key] for key in ("time_limit_s", "seed") if key in stored}
    train = None if train is None else TrainConfig.parse(train)
    return {"structure": structure, "train": train, "dt_s": stored["dt_s"], **known}
