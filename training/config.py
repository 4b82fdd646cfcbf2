"""The configuration of a whole run: one TOML file, one section per room.

Table [steady_state]: which steady-state model, and how a fitted one is fitted.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

from pydantic import AfterValidator, Field, NonNegativeInt, field_validator, model_validator

from data_prep.equilibrium import QuasiSteadyConfig
from data_prep.prepare import Preparation
from narxcal.calibration.fuser_config import FuserConfig
from narxcal.channels import CHANNELS
from narxcal.narx.config import MOST_HIDDEN, MOST_LAGS, Taps
from narxcal.steady.model import SteadyOptions
from narxcal.support.errors import ConfigError
from narxcal.support.files import is_file, is_folder
from narxcal.support.settings import Section, read_toml

Kind = Literal["fitted", "table", "callable", "fmu", "static"]
Auto = Literal["auto"]


def _once(names: tuple[str, ...]) -> tuple[str, ...]:
    """`names`, if none stands there twice; for validators of fields."""
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"'{name}' is named twice")
    return names


Names = Annotated[tuple[str, ...], AfterValidator(_once), Field(min_length=1)]


class SteadyFitConfig(Section):
    """How stiff the curves are.

    `knots` of the spline over the driver; `bend`, `spread` and `scatter` are the penalties on
    curvature, on differences between envelope corners and on engine lines, as shares of the
    mean squared error. `huber` is the residual, in robust standard deviations, beyond which a
    sample loses weight; 0 turns that off. The curves go on straight for `reach` of the driver's
    range beyond the samples (those of temperatures, which may turn, for 0.15 at most), and are held
    from there on; both count as outside the envelope.
    """

    knots: int = Field(default=8, ge=2, le=200)
    bend: float = Field(default=1e-3, ge=0)
    spread: float = Field(default=3e-4, ge=0)
    scatter: float = Field(default=1e-4, ge=0)
    huber: float = Field(default=0.0, ge=0)
    reach: float = Field(default=1.0, ge=0)


class SteadyStateConfig(Section):
    """Table [steady_state]: fit a model to the logs, or load the maker's.

    `kind` "fitted" uses `inputs` (which must hold ALT_ft, Mach and dT_C if `corrected`) and
    blends curves over `driver` (that of [events] where it is empty) between the extremes of
    `blend`. `exponents` are the ratios of the air whose exponents are fitted, not those of
    similarity. `switches` add a line each while they are on; they are inputs whether named there or
    not. What is "auto" is chosen by the training logs (see training.steady.steady_choice). The
    other kinds load `source`: a CSV table, `module:function` or an FMU file.
    """

    kind: Kind = "fitted"
    source: str = ""
    inputs: Names = ("TRA_deg", "ALT_ft", "Mach", "dT_C")
    driver: str = ""
    blend: Auto | tuple[str, ...] = "auto"
    switches: Auto | tuple[str, ...] = "auto"
    corrected: Auto | bool = "auto"
    exponents: Auto | tuple[Literal["theta", "delta"], ...] = "auto"
    fit: SteadyFitConfig = SteadyFitConfig()
    options: SteadyOptions = SteadyOptions()

    @model_validator(mode="after")
    def _consistent(self) -> SteadyStateConfig:
        if self.kind != "fitted" and not self.source:
            raise ValueError(f"kind '{self.kind}' needs a source")
        blend = () if self.blend == "auto" else self.blend
        missing = [name for name in blend if name not in self.inputs]
        if missing:
            raise ValueError(f"blend names '{missing[0]}', which is no input")
        return self

    @field_validator("switches")
    @classmethod
    def _are_switches(cls, names: Auto | tuple[str, ...]) -> Auto | tuple[str, ...]:
        for name in () if names == "auto" else names:
            if name not in CHANNELS or CHANNELS[name].role != "switch":
                known = ", ".join(each.name for each in CHANNELS.values() if each.role == "switch")
                raise ValueError(f"'{name}' is no switch; switches are {known}")
        return names


SCHEMA: Final = "narxcal.config/1"
_DECAY_BEHIND_LAGS: Final = 0.03
_SCHEDULE: Final = ("ALT_ft", "Mach")
_LINKED: Final = ("narx", "train", "steady_state")
_SCENARIO: Final = "fly_"  # begins the names of scenarios of virtual flights, shipped too


class NarxSection(Section):
    """Table [narx]: the network over the deviation from steady state.

    `outputs` are the channels it calibrates; `joint` = false trains one network per output.
    `schedule` names the inputs that change how fast the engine moves. `anchored` makes the
    steady-state model an exact equilibrium; without it the network is the paper's. `settle_s` is
    the longest time constant with which an anchored network's deviation may fade; 0 means any.
    `lag` puts state-dependent lags in front of an anchored network, which then learns their
    residual; they are fitted to errors as shares of each response, and the heat of the metal is
    among them. `lag_limits` adds the control's limits of acceleration and deceleration, and the
    fuel that these take. With `lag_governed` a control governs N1 and N2 follows; `lag_limits`
    then has no meaning. Where these are "auto", the form is chosen by the training logs. With
    `linear_feedback` past deviations bypass the hidden layer: a free run has no wrong equilibrium.
    """

    outputs: Names = ("N1_pct", "N2_pct", "EGT_C")
    schedule: Annotated[tuple[str, ...], AfterValidator(_once)] = _SCHEDULE
    lags: int = Field(default=1, ge=1, le=MOST_LAGS)
    taps: Taps = (0,)
    hidden: int = Field(default=6, ge=1, le=MOST_HIDDEN)
    margin: float = Field(default=0.25, ge=0)
    anchored: bool = True
    settle_s: float = Field(default=40.0, ge=0)
    joint: bool = True
    lag: bool = True
    lag_limits: Auto | bool = "auto"
    lag_governed: Auto | bool = "auto"
    linear_feedback: bool = True

    @model_validator(mode="before")
    @classmethod
    def _network_alone(cls, table: Any) -> Any:
        """Without lags the network learns the whole response: its defaults differ."""
        if not isinstance(table, dict):
            return table
        gone = [name for name in ("lag_errors", "lag_heat") if name in table]
        if gone:
            raise ValueError(
                f"{gone[0]} is no key any more: all lags have heat, which is nil where logs show "
                "none, and are fitted to errors relative to each response; remove it"
            )
        lag = table.get("lag", table.get("anchored", True))
        own = {} if lag else {"lags": 2, "linear_feedback": False}
        return {"lag": lag, **own, **table}

    @model_validator(mode="after")
    def _lag_needs_an_anchor(self) -> NarxSection:
        if self.lag and not self.anchored:
            raise ValueError("lag = true needs anchored = true")
        if self.lag_governed is True and not self.lag:
            raise ValueError("lag_governed = true needs lag = true")
        return self


class TrainConfig(Section):
    """Table [train]: free-run training by horizons that grow.

    `optimiser` is Levenberg-Marquardt ("lm") or "adam". `horizons_s` are the lengths of the windows
    in seconds, 0 for whole logs, and `iterations` the steps at each. Whole logs are run from
    `restarts` places in each: from one alone, a network may memorise that start.
    `starts` networks are drawn from `seed` on and the best is kept. One sample in every
    `score_every_s` is scored. Training stops early after `patience` steps without a lower free-run
    error on the validation logs, where there are any. `local_trim` removes the static error from
    the training deviations where the engine is in equilibrium as `still` defines it (see
    training.records). `rest_s` is the length of the synthetic records of the return to equilibrium;
    0 means none; with `rest_far` there are more of them, they begin at large deviations, and the
    second half of each is scored.
    With `emphasis = "motion"` transients weigh more than equilibrium, their onset most, and low
    power more than high. Held-out parts of the training logs say which model leads a speed, and
    with which weights the models are mixed in another output (see `training.dynamics.mixture`);
    `choice_s` are the nominal CPU seconds that these may take, 0 for the network alone.
    `delay_s` is the transport delay of the driver, found on held-out logs where it is "auto".
    """

    optimiser: Literal["lm", "adam"] = "lm"
    horizons_s: tuple[Annotated[float, Field(ge=0, le=1e6)], ...] = Field(
        default=(5.0, 60.0), min_length=1
    )
    iterations: tuple[NonNegativeInt, ...] = (8, 12)
    restarts: int = Field(default=1, ge=1, le=1000)
    starts: int = Field(default=1, ge=1, le=1000)
    seed: int = Field(default=0, ge=0, lt=2**63)
    decay: float = Field(default=1e-5, ge=0)
    rate: float = Field(default=0.01, gt=0)
    score_every_s: float = Field(default=0.3, gt=0)
    patience: int = Field(default=8, ge=1)
    threads: int = Field(default=2, ge=1, le=1024)
    local_trim: bool = True
    rest_s: float = Field(default=20.0, ge=0)
    rest_far: bool = False
    emphasis: Literal["even", "motion"] = "even"
    choice_s: float = Field(default=120.0, ge=0)
    delay_s: Auto | Annotated[float, Field(ge=0, le=60.0)] = "auto"
    still: QuasiSteadyConfig = QuasiSteadyConfig(window_s=4.0, speed_pct=0.4, driver_fraction=0.02)

    @model_validator(mode="after")
    def _paired(self) -> TrainConfig:
        if len(self.horizons_s) != len(self.iterations):
            raise ValueError(
                f"horizons_s and iterations have to be of one length, found "
                f"{len(self.horizons_s)} and {len(self.iterations)}"
            )
        return self


METHODS: Final = ("narx", "output-error", "transfer", "subspace")
STATIC: Final = "static:"


class IdentifyConfig(Section):
    """Table [identify]: by which method a model is identified, and what single methods take.

    `method` is one of `METHODS` or static:NAME. `response` is the order of a transfer function,
    chosen by its free-run error where it is "auto"; `levels` (steady values of the output) and
    `altitudes_ft` are the nodes of its parameters, chosen by the motion in the logs where they are
    empty. `order` is that of a state space (0: chosen), `block_rows` its window. `static` are
    arguments of a static law, such as F0_kN, or output and degrees of a polynomial.
    """

    method: str = "narx"
    response: Literal["auto", "first", "second"] = "auto"
    levels: tuple[float, ...] = ()
    altitudes_ft: tuple[float, ...] = ()
    order: int = Field(default=0, ge=0, le=20)
    block_rows: int = Field(default=12, ge=2, le=200)
    static: dict[str, Any] = Field(default_factory=dict)

    @field_validator("method")
    @classmethod
    def _is_known(cls, name: str) -> str:
        if name not in METHODS and not name.startswith(STATIC):
            raise ValueError(f"expected {', '.join(METHODS)} or {STATIC}NAME")
        return name

    @field_validator("levels", "altitudes_ft")
    @classmethod
    def _ascend(cls, nodes: tuple[float, ...]) -> tuple[float, ...]:
        if any(b <= a for a, b in pairwise(nodes)):
            raise ValueError("nodes have to ascend")
        return nodes


class SplitConfig(Section):
    """Table [split]: patterns of log names (FILE:engine); a log's first match decides.

    Whole logs only: lags and scores never cross from one set into another. An empty `test`
    means that every log which is in no other set is a test log.
    """

    train: tuple[str, ...] = ("*",)
    validate_: tuple[str, ...] = Field(default=(), alias="validate")
    test: tuple[str, ...] = ()


class RunConfig(Preparation):
    """Everything that decides a run; `evaluate` is parsed by the evaluation itself."""

    schema_: Literal["narxcal.config/1"] = Field(default=SCHEMA, alias="schema")
    name: str = "narxcal"
    steady_state: SteadyStateConfig = SteadyStateConfig()
    narx: NarxSection = NarxSection()
    train: TrainConfig = TrainConfig()
    identify: IdentifyConfig = IdentifyConfig()
    split: SplitConfig = SplitConfig()
    fuser: FuserConfig = FuserConfig()
    evaluate: dict[str, Any] = Field(default_factory=dict)

    def named_channels(self) -> tuple[str, ...]:
        """Channels that the tables name, which have to be built in or declared."""
        narx = self.narx
        own = (*self.steady_state.inputs, *narx.outputs, *narx.schedule)
        return (*super().named_channels(), *own)

    @property
    def driver(self) -> str:
        """The channel over which steady-state curves are drawn: that of [events] unless named."""
        return self.steady_state.driver or self.events.driver

    def having(self, **tables: Mapping[str, Any]) -> Self:
        """The same with values of some tables replaced, unchecked: `train={"threads": 1}`."""
        changed = {
            name: getattr(self, name).model_copy(update=values) for name, values in tables.items()
        }
        return self.model_copy(update=changed)

    def with_logs_in(self, folder: Path) -> Self:
        """The same with `folder` in the place of [logs] folder."""
        return self.having(logs={"folder": str(folder.resolve())})

    @model_validator(mode="before")
    @classmethod
    def _linked_defaults(cls, table: Any) -> Any:
        """Weight decay depends on whether there are lags, the usual schedule on the inputs.

        A network behind lags only corrects them; alone it has to learn the whole response.
        """
        parts = [table.get(name, {}) for name in _LINKED] if isinstance(table, dict) else []
        if not parts or not all(isinstance(part, dict) for part in parts):
            return table  # pydantic reports what is wrong
        narx, train, steady = (dict(part) for part in parts if isinstance(part, dict))
        if narx.get("lag", narx.get("anchored", True)):
            train = {"decay": _DECAY_BEHIND_LAGS, **train}
        inputs = steady.get("inputs", _SCHEDULE)
        if isinstance(inputs, list | tuple):
            narx = {"schedule": [name for name in _SCHEDULE if name in inputs], **narx}
        return {**table, "narx": narx, "train": train}

    @model_validator(mode="after")
    def _inputs_serve(self) -> RunConfig:
        """The network's schedule and the fitted curves' driver come from the same inputs."""
        inputs = self.steady_state.inputs
        needed = [("[narx] schedule", name) for name in self.narx.schedule]
        if self.steady_state.kind == "fitted":
            key = "[steady_state] driver" if self.steady_state.driver else "[events] driver"
            needed.append((key, self.driver))
        for key, name in needed:
            if name not in inputs:
                raise ConfigError(
                    f"{key} names '{name}', which is not in [steady_state] inputs",
                    hint=f"Inputs are {', '.join(inputs)}",
                )
        for name in self.narx.outputs:
            if name in inputs:
                raise ConfigError(
                    f"'{name}' is an output in [narx] and an input in [steady_state]",
                    hint="Remove it from one of them",
                )
        return self


def load_config(path: str | Path) -> tuple[RunConfig, Path]:
    """Read a TOML file; returns the configuration and the folder its paths are relative to.

    A name that is no file is looked up among the shipped configurations, with or without `.toml`.
    Raises `ConfigError` for a missing file, a folder, bad TOML, an unknown key or a bad value.
    """
    file = Path(path)
    if is_folder(file):
        raise ConfigError(
            "a configuration is a file, and this is a folder",
            file=file,
            hint="Name the TOML file in it",
        )
    if not is_file(file):
        shipped = Path(str(files("configs"))) / f"{file.name.removesuffix('.toml')}.toml"
        if not is_file(shipped):
            there = sorted(item.name for item in shipped.parent.glob("*.toml"))
            names = [name for name in there if not name.startswith(_SCENARIO)]
            raise ConfigError(
                "the configuration does not exist",
                file=file,
                hint=f"Name a file, or one of the shipped {', '.join(names)}",
            )
        file = shipped
    return RunConfig.parse(read_toml(file, SCHEMA), file), file.resolve().parent
