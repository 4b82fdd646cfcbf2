"""`Narx`: the scikit-learn-like door to the network, for any records of inputs and outputs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator

from narxcal.errors import ModelError
from narxcal.narx import NarxConfig
from narxcal.narx_model import NarxModel
from narxcal.records import Record
from training.config import TrainConfig
from training.trainer import FitResult, Material, Watch, fit_narx

FloatArray = NDArray[np.float64]


class Narx(BaseEstimator):  # type: ignore[misc]  # scikit-learn ships no types
    """NARX network trained on its free run over one or several records.

    `structure` holds lags, input taps and width, `train` the optimiser and its horizons (in the
    unit of `dt_s`, which is 1 by default: then horizons count samples). Tap 0 is the input at
    the predicted sample itself; leave it out where that must not be used.

    >>> import numpy as np
    >>> u = np.sin(0.3 * np.arange(300)) + np.cos(0.05 * np.arange(300) ** 1.2)
    >>> y = np.zeros(300)
    >>> for k in range(1, 300):
    ...     y[k] = 0.8 * y[k - 1] + 0.2 * np.tanh(2.0 * u[k - 1])
    >>> model = Narx(NarxConfig(lags=1, taps=(1,), hidden=4)).fit([Record(u, y)])
    >>> bool(model.score([Record(u, y)]) > 0.999)
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
        records: Sequence[Record],
        validation: Sequence[Record] = (),
        watch: Watch | None = None,
    ) -> Self:
        """Train on whole records; stop and select by `validation` records where given.

        NaN outputs are masked. Raises `DataError` for records that do not fit each other.
        """
        train = self.train or TrainConfig(
            horizons_s=(20.0, 200.0, 0.0), iterations=(10, 20, 40), score_every_s=1.0
        )
        material = Material(list(records), list(validation), self.dt_s)
        self.result_: FitResult = fit_narx(material, self.structure or NarxConfig(), train, watch)
        return self

    @property
    def model(self) -> NarxModel:
        """The trained network; raises `ModelError` before `fit`."""
        if not hasattr(self, "result_"):
            raise ModelError("the NARX network is not trained yet", hint="Call fit first")
        return self.result_.model

    def simulate(self, u: ArrayLike, start: ArrayLike) -> FloatArray:
        """Free run (time, outputs) over `u` (time, inputs); `start` are its first n samples."""
        return self.model.simulate(_columns(u), _columns(start, one_row=True))

    def predict(self, u: ArrayLike, y: ArrayLike) -> FloatArray:
        """One-step-ahead prediction (time, outputs) from measured outputs (time, outputs)."""
        return self.model.predict(_columns(u), _columns(y))

    def score(self, records: Sequence[Record], start: int = 1) -> float:
        """Coefficient of determination of the free run, pooled over records and outputs.

        The first `start` measured samples of each record initialise it and are not scored.
        """
        error, spread = 0.0, 0.0
        for record in records:
            y = self.model.simulate(record.u, np.nan_to_num(record.y[:start]))
            scored = slice(start, None)
            centre = np.nanmean(record.y, axis=0)
            error += float(np.nansum((y[scored] - record.y[scored]) ** 2))
            spread += float(np.nansum((record.y[scored] - centre) ** 2))
        return 1.0 - error / spread

    def __sklearn_tags__(self) -> Any:
        """Tell scikit-learn's displays what this is."""
        tags = super().__sklearn_tags__()
        tags.estimator_type = "regressor"
        return tags


def _columns(values: ArrayLike, *, one_row: bool = False) -> FloatArray:
    """1-D arrays as one channel over time, or (`one_row`) as one sample of all channels."""
    array = np.asarray(values, dtype=np.float64)
    if array.ndim == 1:
        return array[None] if one_row else array[:, None]
    return array
