"""From raw logs to prepared ones: cleaned, then smoothed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

from data_prep.clean import CleanConfig, clean
from data_prep.log import Log
from data_prep.smooth import SmoothConfig, smooth


class Sections(Protocol):
    """Whatever holds the two tables: the whole run configuration, or `Preparation`."""

    @property
    def clean(self) -> CleanConfig:
        """Table `[clean]`."""

    @property
    def smooth(self) -> SmoothConfig:
        """Table `[smooth]`."""


@dataclass(frozen=True)
class Preparation:
    """The two tables alone, for use without a run configuration."""

    clean: CleanConfig = field(default_factory=CleanConfig)
    smooth: SmoothConfig = field(default_factory=SmoothConfig)


def prepare(logs: Sequence[Log], sections: Sections | None = None) -> list[Log]:
    """Clean, then smooth each log; what cleaning changed is in its audit."""
    wanted = sections or Preparation()
    return [smooth(clean(log, wanted.clean), wanted.smooth) for log in logs]
