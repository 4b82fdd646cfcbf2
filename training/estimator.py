"""`Narx`: a scikit-learn estimator of the network for any records, and its folder.

The folder of a trained one holds `narx.json` and `weights.safetensors`.

    schema      "narxcal.narx/1"
    parameters  structure, train and dt_s as given, null for what was left to the default
    network     structure and width of the trained network
    result      how the training ended: status, score, every step
    weights     file, SHA-256, shapes; the arrays themselves are in that file
    sha256      of parameters, network and result
    versions    of Python and the packages that made it

A number that is not finite, such as a validation error without validation records, is null.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from os import PathLike
from pathlib import Path
from typing import Any, Self, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator
from sklearn.exceptions import NotFittedError

from narxcal.calibration.bundle import WEIGHTS, ModelFolder, packed, seal
from narxcal.narx.config import NarxConfig
from narxcal.narx.network import NarxModel
from narxcal.record import Record, RecordLike, as_records, check_records, columns
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError, DataError, ModelError
from narxcal.support.files import atomic_folder, atomic_write_bytes, atomic_write_text, versions
from training.config import TrainConfig
from training.network import FitResult, HistoryRow, Material, Watch, fit_narx

_FORM = ModelFolder(
    what="stored Narx",
    document="narx.json",
    schemas=("narxcal.narx/1",),
    made_by="Narx.save",
    again="Copy the folder again, or train anew",
)
T = TypeVar("T", NarxConfig, TrainConfig)
_SEALED = ("parameters", "network", "result")


@dataclass(frozen=True, eq=False)
class Stored:
    """What a trained estimator is made of: its parameters as given, and the result of `fit`."""

    structure: NarxConfig | None
    train: TrainConfig | None
    dt_s: float
    result: FitResult


def save(folder: str | PathLike[str], stored: Stored, *, replace: bool = False) -> None:
    """Write a new folder, whole or not at all; raises as `narxcal.support.files.atomic_folder`."""
    network, arrays = stored.result.model.to_arrays()
    weights, entry = packed(arrays)
    sealed = {
        "parameters": {
            "structure": _dumped(stored.structure),
            "train": _dumped(stored.train),
            "dt_s": float(stored.dt_s),
        },
        "network": network,
        "result": {
            "status": stored.result.status,
            "score": _number(stored.result.score),
            "history": [
                {key: _number(value) for key, value in asdict(row).items()}
                for row in stored.result.history
            ],
        },
    }
    document = {
        "schema": _FORM.schemas[0],
        **sealed,
        "sha256": seal(json.loads(json.dumps(sealed))),
        "weights": entry,
        "versions": versions(),
    }
    with atomic_folder(folder, replace) as part:
        atomic_write_bytes(part / WEIGHTS, weights)
        text = json.dumps(document, indent=1, allow_nan=False) + "\n"
        atomic_write_text(part / _FORM.document, text)


def load(folder: str | PathLike[str]) -> Stored:
    """Read what `save` wrote; `ModelError` for a folder that is another, damaged or altered."""
    source = Path(folder)
    document = _FORM.read_document(source)
    arrays = _FORM.read_arrays(source, document)
    sealed = {key: _FORM.part(source, document, key) for key in _SEALED}
    file = source / _FORM.document
    if seal(sealed) != document.get("sha256"):
        problem = f"{', '.join(_SEALED[:-1])} or {_SEALED[-1]} were altered"
        raise ModelError(problem, file=file, hint=_FORM.again)
    try:
        return _stored(sealed, NarxModel.from_arrays(sealed["network"], arrays))
    except (KeyError, TypeError, ConfigError) as error:
        raise ModelError(f"a part cannot be read: {error}", file=file, hint=_FORM.again) from None


def _stored(sealed: Mapping[str, Any], model: NarxModel) -> Stored:
    given, result = sealed["parameters"], sealed["result"]
    return Stored(
        structure=_parsed(NarxConfig, given["structure"]),
        train=_parsed(TrainConfig, given["train"]),
        dt_s=given["dt_s"],
        result=FitResult(
            model=model,
            status=result["status"],
            score=_known(result["score"]),
            history=tuple(_row(row) for row in result["history"]),
        ),
    )


def _row(row: Mapping[str, Any]) -> HistoryRow:
    return HistoryRow(**{key: _known(value) for key, value in row.items()})


def _dumped(section: NarxConfig | TrainConfig | None) -> dict[str, Any] | None:
    return None if section is None else section.model_dump(mode="json", by_alias=True)


def _parsed(kind: type[T], given: Any) -> T | None:
    return None if given is None else kind.parse(given)


def _number(value: float) -> float | None:
    """JSON has no NaN."""
    return value if math.isfinite(value) else None


def _known(value: Any) -> Any:
    return math.nan if value is None else value


Records: TypeAlias = RecordLike | Iterable[RecordLike]

# Default for unknown records. On held-back stretches of the training ranges of three public sets
# (`python -m eval.bench`), eight lags have 0.5 to 0.9 times the error of two or four.
_STRUCTURE = NarxConfig(lags=8, taps=tuple(range(9)), hidden=8)
# Horizons in samples.
_TRAIN = TrainConfig(horizons_s=(20.0, 200.0, 0.0), iterations=(10, 20, 40), score_every_s=1.0)
_SECTIONS = ("structure", "train")


class NotTrainedError(ModelError, NotFittedError):  # type: ignore[misc]  # scikit-learn ships no types
    """The network is not trained yet; also scikit-learn's `NotFittedError`."""


class Narx(BaseEstimator):  # type: ignore[misc]  # likewise
    """NARX network trained on its free run over one or several records.

    `structure` holds lags, input taps and width, `train` the optimiser and its horizons (in the
    unit of `dt_s`, which is 1 by default: then horizons count samples). Tap 0 is the input at
    the predicted sample itself; leave it out where that must not be used. Left out, they are
    8 lags, taps 0 to 8 and 8 hidden units; fewer do for a system of low order.

    A record is a pair of arrays `(u, y)` (time, inputs) and (time, outputs), or a `Record`, which
    also has a name; methods take one of these or several. Searches of scikit-learn reach into
    both sections: `GridSearchCV(Narx(), {"structure__hidden": [4, 8]}).fit(records)`. `save` and
    `Narx.load` keep a trained one in a folder.

    >>> import numpy as np
    >>> u = np.sin(0.3 * np.arange(300)) + np.cos(0.05 * np.arange(300) ** 1.2)
    >>> y = np.zeros(300)
    >>> for k in range(1, 300):
    ...     y[k] = 0.8 * y[k - 1] + 0.2 * np.tanh(2.0 * u[k - 1])
    >>> model = Narx(NarxConfig(lags=1, taps=(1,), hidden=4)).fit([(u, y)])
    >>> bool(model.score([(u, y)]) > 0.999)
    True
    """

    def __init__(
        self,
        structure: NarxConfig | None = None,
        train: TrainConfig | None = None,
        dt_s: float = 1.0,
    ) -> None:
        self.structure = structure
        self.train = train
        self.dt_s = dt_s

    def fit(
        self,
        records: Records,
        validation: Records | None = None,
        watch: Watch | None = None,
    ) -> Self:
        """Train on whole records; stop and select by `validation` records where given.

        NaN outputs are masked. Raises `DataError` for what is no record, and for records that do
        not fit each other, `ConfigError` for parameters that are none.
        """
        structure, train = self._sections()
        if not self.dt_s > 0.0 or not np.isfinite(self.dt_s):
            raise ConfigError(f"key 'dt_s': expected a time above 0, found {self.dt_s}")
        learned = as_records(records)
        held_out = [] if validation is None else as_records(validation, "validation record")
        material = Material(learned, held_out, self.dt_s)
        self.result_: FitResult = fit_narx(material, structure, train, watch)
        return self

    @property
    def model(self) -> NarxModel:
        """The trained network; raises `NotTrainedError` before `fit`."""
        if not hasattr(self, "result_"):
            raise _not_trained()
        return self.result_.model

    def save(self, folder: str | PathLike[str], *, replace: bool = False) -> None:
        """Write the trained network and all parameters to a new folder, without pickle.

        Raises `NotTrainedError` before `fit`, and `ConfigError` for a folder that has content (with
        `replace`, other than narxcal's) or cannot be written.
        """
        self._sections()
        if not hasattr(self, "result_"):
            raise _not_trained()
        stored = Stored(self.structure, self.train, self.dt_s, self.result_)
        save(folder, stored, replace=replace)

    @classmethod
    def load(cls, folder: str | PathLike[str]) -> Self:
        """Read what `save` wrote: the same parameters, and a network that computes the same.

        Raises `ModelError` for a folder that is another, damaged or altered.
        """
        stored = load(folder)
        loaded = cls(stored.structure, stored.train, stored.dt_s)
        loaded.result_ = stored.result
        return loaded

    def simulate(self, u: ArrayLike, start: ArrayLike) -> FloatArray:
        """Free run (time, outputs) over `u` (time, inputs); `start` are its first n samples.

        `start` is (n, outputs); of one dimension it is (n,) where there is one output, and one
        sample (outputs,) where there are several.
        """
        single = self.model.outputs == 1
        return self.model.simulate(columns(u), columns(start) if single else start)

    def predict(self, u: ArrayLike, y: ArrayLike) -> FloatArray:
        """One-step-ahead prediction (time, outputs) from measured outputs (time, outputs)."""
        return self.model.predict(columns(u), columns(y))

    def score(self, records: Records, y: None = None, *, start: int = 1) -> float:
        """Coefficient of determination of the free run, pooled over records and outputs.

        Where the outputs never vary it is 1 for a free run without error, else 0. `y` is nothing:
        scikit-learn's pipelines pass targets beside the records.

        The first `start` measured samples of each record initialise it and are not scored; one
        that is masked takes the channel's first known value. Raises `DataError` for records that
        the model or `start` does not fit, and for one in which an output is masked throughout.
        """
        del y
        error, spread = 0.0, 0.0
        for record in self._scorable(records, start):
            free_run = self.model.simulate(record.u, _known_start(record.y, start))
            scored = slice(start, None)
            centre = np.nanmean(record.y, axis=0)
            error += float(np.nansum((free_run[scored] - record.y[scored]) ** 2))
            spread += float(np.nansum((record.y[scored] - centre) ** 2))
        if spread == 0.0:  # as scikit-learn scores what never varies
            return 1.0 if error == 0.0 else 0.0
        return 1.0 - error / spread

    def _scorable(self, given: Records, start: int) -> list[Record]:
        if start < 1:
            raise DataError(f"expected at least one start sample, found start = {start}")
        records, net = as_records(given), self.model
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

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Settings by name; if `deep`, the keys of both sections too, as `structure__hidden`."""
        params: dict[str, Any] = super().get_params(deep=False)
        if deep:
            for name, section in zip(_SECTIONS, self._sections(), strict=True):
                params |= {f"{name}__{key}": value for key, value in section}
        return params

    def set_params(self, **params: Any) -> Self:
        """Set parameters by the names of `get_params`.

        Raises `ConfigError` for a bad key or value of a section, `ValueError` for a strange name.
        """
        own: dict[str, Any] = {}
        nested: dict[str, dict[str, Any]] = {name: {} for name in _SECTIONS}
        for name, value in params.items():
            head, _, key = name.partition("__")
            if key and head in nested:
                nested[head][key] = value
            else:
                own[name] = value
        super().set_params(**own)
        for name, section in zip(_SECTIONS, self._sections(), strict=True):
            if nested[name]:
                setattr(self, name, type(section).parse(dict(section) | nested[name]))
        return self

    def _sections(self) -> tuple[NarxConfig, TrainConfig]:
        structure = _STRUCTURE if self.structure is None else self.structure
        train = _TRAIN if self.train is None else self.train
        for name, given, kind in (
            ("structure", structure, NarxConfig),
            ("train", train, TrainConfig),
        ):
            if not isinstance(given, kind):
                raise ConfigError(
                    f"key '{name}': expected {kind.__name__}, found {type(given).__name__}",
                    hint=f"Pass {kind.__name__}(...)",
                )
        return structure, train

    def __sklearn_tags__(self) -> Any:
        """Mark the estimator as a regressor for scikit-learn."""
        tags = super().__sklearn_tags__()
        tags.estimator_type = "regressor"
        return tags


def _not_trained() -> NotTrainedError:
    return NotTrainedError("the NARX network is not trained yet", hint="Call fit first")


def _known_start(y: FloatArray, samples: int) -> FloatArray:
    first = y[np.isfinite(y).argmax(axis=0), np.arange(y.shape[1])]
    return np.where(np.isfinite(y[:samples]), y[:samples], first)
