"""The structure of the NARX network, as configurations give it; without the network itself.

Who only reads a configuration does not wait for PyTorch.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, Field

from narxcal.support.settings import Section


def _increasing(taps: tuple[int, ...]) -> tuple[int, ...]:
    if not taps or taps[0] < 0 or list(taps) != sorted(set(taps)):
        raise ValueError("has to list increasing delays >= 0, for example [0, 1]")
    return taps


Taps = Annotated[tuple[int, ...], AfterValidator(_increasing)]


class NarxConfig(Section):
    """Structure of the network; delays count samples.

    `lags` past outputs are fed back. `taps` are the input delays: 0 is the input at the sample
    that is predicted, so (0, 1) needs u(k) and u(k-1); a model that must not see u(k) uses
    (1, 2). `margin` widens the envelope of the training outputs, as a share of its width, to
    the bounds at which the output is clamped.

    `moving` > 0 says that the first so many inputs are increments, which vanish at rest, and
    makes the network *anchored*: it subtracts its own value at rest, so that outputs of zero
    are an exact equilibrium wherever the other inputs stand still. With `linear_feedback` past
    outputs reach the linear path alone: an anchored network with its poles inside the unit circle
    then has no other place to rest.
    """

    lags: int = Field(default=2, ge=1)
    taps: Taps = (0, 1)
    hidden: int = Field(default=8, ge=1)
    margin: float = Field(default=0.25, ge=0)
    moving: int = Field(default=0, ge=0)
    linear_feedback: bool = False
