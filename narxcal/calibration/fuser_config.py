"""Table [fuser], apart from the fuser: configurations are read without filterpy."""

from __future__ import annotations

from pydantic import Field

from narxcal.support.settings import Section


class FuserConfig(Section):
    """Table `[fuser]`.

    A measurement whose innovation a correct filter would show less often than
    `1 - gate_probability` is left out; innovations that stay outside, on one side, for `relock_s`
    are a real change and the channel starts again from its measurement.
    """

    gate_probability: float = Field(default=1.0 - 1e-6, gt=0.5, lt=1.0)
    relock_s: float = Field(default=0.3, gt=0.0)
