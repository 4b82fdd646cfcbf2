"""What a run is, besides its model: configuration, data, seeds, and what each step chose and left.

`training.pipeline` writes a `RunRecord`, `narxcal.calibration.bundle` stores it in `bundle.json`,
every command reads it. Parts that were not written are None or empty; entries that this version
does not know are kept as they are.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, ConfigDict, Field, PlainSerializer

from narxcal.calibration.certificate import Certificate
from narxcal.calibration.delay import TransportDelay
from narxcal.calibration.noise import NoiseModel
from narxcal.support.settings import Section

Table = dict[str, Any]
# JSON has no number for what is not finite: it is null there.
Number = Annotated[float, BeforeValidator(lambda found: np.nan if found is None else found)]


class _Part(Section):
    model_config = ConfigDict(extra="allow", allow_inf_nan=True)


class StepRow(_Part):
    """One step of the optimiser: `loss` is half the mean squared error in scaled units."""

    start: int
    horizon_s: float
    iteration: int
    loss: Number
    validation: float | None = None


class TrainingRecord(_Part):
    """How the fit of the dynamics ended; of a network also its score and steps, by network."""

    status: str = ""
    score: tuple[Number, ...] = ()
    history: tuple[tuple[StepRow, ...], ...] = ()
    wall_s: Number = np.nan


class SteadyRecord(_Part):
    """The fit of the steady state; `fitted` is False for a maker's model. `rms` is by output."""

    fitted: bool
    samples: int = 0
    rms: dict[str, Number] = Field(default_factory=dict)
    coverage: Number = np.nan
    corrected: bool | None = None
    blend: tuple[str, ...] = ()
    switches: tuple[str, ...] = ()
    exponents: tuple[str, ...] = ()
    assumed: tuple[str, ...] = ()


class LagRecord(_Part):
    """The form of the lags, and by form the residual share on left-out logs."""

    form: str = ""
    left: dict[str, Number] = Field(default_factory=dict)


class FitRecord(_Part):
    """Free run over the training logs; `samples` and `rmse` are by output."""

    samples: dict[str, int] = Field(default_factory=dict)
    rmse: dict[str, Number] = Field(default_factory=dict)
    parameters: int = 0
    aic: float | None = None


class IdentityRecord(_Part):
    """What a log that the model learned from is recognised by (`data_prep.cleaning.identity`)."""

    log: str
    file: str
    sha256: str
    engine: str
    role: Literal["train", "validate"]
    digest: str
    channels: tuple[str, ...]
    span_s: float
    moves: str


class HeldOutRecord(_Part):
    """Free runs over logs that the model was not fitted to, by output and in the order of `logs`.

    `fitted` says that there were none, and that these logs were fitted to.
    """

    logs: tuple[str, ...]
    fitted: bool
    rmse: dict[str, tuple[Number, ...]]


class ResponsesRecord(_Part):
    """Transients of a speed that one model passed, mean loss of their times, its standard error."""

    passed: int = 0
    judged: int = 0
    loss: float | None = None
    loss_error: float | None = None


class MixtureChannel(_Part):
    """Weights of the models in one output, and what they left on what was held out."""

    weights: dict[str, float] = Field(default_factory=dict)
    held_out_rmse: dict[str, float | None] = Field(default_factory=dict)
    held_out_responses: dict[str, ResponsesRecord] = Field(default_factory=dict)
    held_out_level: tuple[float | None, ...] = ()
    held_out_lag_s: tuple[float | None, ...] = ()

    @property
    def ordered(self) -> list[tuple[str, float]]:
        """Models with their weights, the largest first."""
        return sorted(self.weights.items(), key=lambda pair: -pair[1])


class MixtureRecord(_Part):
    """By output the models' weights; `suspects` are sentences on logs that no model follows."""

    status: str = ""
    held_out: tuple[str, ...] = ()
    channels: dict[str, MixtureChannel] = Field(default_factory=dict)
    suspects: tuple[str, ...] = ()


class ScreenedLog(_Part):
    """How many samples of a training log are masked for faults, and how many rows go."""

    log: str
    rows: int
    masked: dict[str, int]
    left_out_rows: int


class ContradictingLog(_Part):
    """A training log that contradicts the others as a whole, and a sentence on it."""

    log: str = ""
    words: str


class ScreeningRecord(_Part):
    """What the training logs' screening found; `findings` are rows of `data_prep.log.Finding`."""

    findings: tuple[Table, ...] = ()
    logs: tuple[ScreenedLog, ...] = ()
    contradicting: tuple[ContradictingLog, ...] = ()


class DelayRecord(_Part):
    """The delay that was found, and ln of the held-out error at each candidate."""

    found: TransportDelay | None = None
    ln_error: tuple[tuple[Number, Number], ...] = ()


class RunRecord(_Part):
    """Provenance and results of a training.

    `config` is the resolved configuration, in which nothing is "auto", and `configured` the one
    given; `base` is the folder that their paths are relative to. `data` maps files to SHA-256,
    `split` train, validate and test to names of logs.
    """

    versions: Table = Field(default_factory=dict)
    configured: Table | None = None
    base: str = "."
    split: dict[str, tuple[str, ...]] = Field(default_factory=dict)
    data: dict[str, str] = Field(default_factory=dict)
    seeds: tuple[int, ...] = ()
    hardware: Table = Field(default_factory=dict)
    config: Table = Field(default_factory=dict)
    steady_state: SteadyRecord | None = None
    lag_form: LagRecord | None = None
    training: TrainingRecord = TrainingRecord()
    baselines: Table | None = None
    mixture: MixtureRecord | None = None
    identify: Table | None = None
    free_run: FitRecord | None = None
    fuser_noise: Table | None = None
    screening: ScreeningRecord | None = None
    redundancy: Table | None = None
    certificate: Annotated[Certificate, PlainSerializer(lambda one: one.row())] | None = None
    identities: tuple[IdentityRecord, ...] = ()
    held_out: HeldOutRecord | None = None
    delay: DelayRecord | None = None

    @property
    def doubtful_logs(self) -> list[str]:
        """Training logs left out as a whole, and logs that no model follows, in words."""
        left_out = self.screening.contradicting if self.screening else ()
        return [*(each.words for each in left_out), *self.weighed.suspects]

    def to_json(self) -> Table:
        """Return the entries that were given, as JSON-able values."""
        return self.model_dump(mode="python", exclude_unset=True)

    def having(self, **parts: Any) -> RunRecord:
        """Return the record with other `parts`; raises `ConfigError` for one of a wrong type."""
        return RunRecord.parse({**self.to_json(), **parts})

    @property
    def interrupted(self) -> bool:
        """Whether Ctrl-C ended the training."""
        return "interrupted" in self.training.status

    @property
    def method(self) -> str:
        """By which method the dynamics were identified; "narx" for `train`."""
        return str(self.config.get("identify", {}).get("method", "narx"))

    @property
    def noise(self) -> NoiseModel | None:
        return None if self.fuser_noise is None else NoiseModel.from_dict(self.fuser_noise)

    @property
    def weighed(self) -> MixtureRecord:
        """The models' weights and held-out errors; without channels where nothing was chosen."""
        return self.mixture or MixtureRecord()

    def logs(self, role: str) -> tuple[str, ...]:
        """Names of the logs of "train", "validate" or "test"."""
        return self.split.get(role, ())
