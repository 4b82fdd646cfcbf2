"""Options of the maker's steady-state model, as configurations give them; without any model."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from narxcal.support.settings import Section

Method = Literal["linear", "pchip"]


class SteadySourceOptions(Section):
    """What differs between the kinds, all optional.

    `method` of a table's interpolation; `ranges` `{input: (low, high)}`, the envelope of a
    callable or an FMU; `variables` `{channel: name in the FMU}`; `settle_s`, how long an FMU
    is run before it is read.
    """

    method: Method = "linear"
    ranges: dict[str, tuple[float, float]] = Field(default_factory=dict)
    variables: dict[str, str] = Field(default_factory=dict)
    settle_s: float = Field(default=1.0, gt=0.0)
