"""What a replay is told: the model and its fuser, and how to treat the log."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, Self

from pydantic import Field

from data_prep.logs_config import LogsConfig
from narxcal.fuser_config import FuserConfig
from narxcal.fuser_noise import NoiseModel
from narxcal.settings import Section

if TYPE_CHECKING:
    from narxcal.bundle import Bundle
    from narxcal.calibration import DynamicCalibration


class ReplayOptions(Section):
    """How to replay.

    `engine` picks one of several engines; else all are replayed. An input that is missing keeps
    its last value up to `hold_s`. `start` says where the model begins after a gap: settled, or at
    the measured outputs. With `follow` a growing file is read until it stood still for `idle_s`.

    `noise` is that of the bundle (`stored`), or (`log`) the sensors' is estimated from the first
    `warmup_s` of the log itself, which delays the output so long; the model's stays that of the
    bundle, which has seen whole flights. `auto` is `log` at full speed and `stored` live. A
    bundle without noise is always `log`, for both.
    """

    engine: str | None = None
    realtime: bool = False
    follow: bool = False
    idle_s: float = Field(default=10.0, gt=0.0)
    hold_s: float = Field(default=2.0, ge=0.0)
    start: Literal["steady", "measured"] = "steady"
    noise: Literal["auto", "stored", "log"] = "auto"
    warmup_s: float = Field(default=300.0, gt=0.0)

    @property
    def live(self) -> bool:
        """Whether rows are wanted as soon as they are known."""
        return self.realtime or self.follow

    @property
    def stored_noise(self) -> bool:
        """Whether the bundle's noise serves as it is, if there is any."""
        return self.noise == "stored" or (self.noise == "auto" and self.live)


@dataclass(frozen=True)
class ReplayModel:
    """What a replay needs of a bundle: the model, the columns of its logs, and the fuser."""

    calibration: DynamicCalibration
    logs: LogsConfig = field(default_factory=LogsConfig)
    fuser: FuserConfig = field(default_factory=FuserConfig)
    noise: NoiseModel | None = None

    @classmethod
    def of(cls, bundle: Bundle) -> Self:
        """Read `meta["config"]` (tables `logs` and `fuser`) and `meta["fuser_noise"]`."""
        config = bundle.meta.get("config", {})
        noise = bundle.meta.get("fuser_noise")
        outputs = set(bundle.calibration.output_names) - set(bundle.calibration.input_names)
        return cls(
            bundle.calibration,
            LogsConfig.parse(config.get("logs", {})).sparing(outputs),
            FuserConfig.parse(config.get("fuser", {})),
            None if noise is None else NoiseModel.from_dict(noise),
        )
