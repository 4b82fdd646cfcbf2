"""From raw logs to prepared ones: the running engine's, cleaned, then smoothed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

from data_prep.clean import CleanConfig, clean
from data_prep.log import Log
from data_prep.running import RunningConfig, while_running
from data_prep.smooth import SmoothConfig, smooth


class Sections(Protocol):
    """Whatever holds the three tables: the whole run configuration, or `Preparation`."""

    @property
    def running(self) -> RunningConfig:
        """Table `[running]`."""

    @property
    def clean(self) -> CleanConfig:
        """Table `[clean]`."""

    @property
    def smooth(self) -> SmoothConfig:
        """Table `[smooth]`."""


@dataclass(frozen=True)
class Preparation:
    """The three tables alone, for use without a run configuration."""

    clean: CleanConfig = field(default_factory=CleanConfig)
    smooth: SmoothConfig = field(default_factory=SmoothConfig)
    running: RunningConfig = field(default_factory=RunningConfig)


def prepare(logs: Sequence[Log], sections: Sections | None = None) -> list[Log]:
    """Leave out where the engine stands, then clean and smooth; the audit says what changed."""
    wanted = sections or Preparation()
    runs = while_running(logs, wanted.running)
    return [smooth(clean(log, wanted.clean), wanted.smooth) for log in runs]
