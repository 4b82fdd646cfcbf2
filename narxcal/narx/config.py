"""Structure of the NARX network, apart from it: configurations are read without numba."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, Field

from narxcal.support.settings import Section

# Far beyond any use, and still in memory: 65536 samples are half an hour at 32 Hz.
MOST_LAGS, MOST_DELAY, MOST_HIDDEN = 1024, 65536, 4096


def _increasing(taps: tuple[int, ...]) -> tuple[int, ...]:
    if taps and taps[-1] > MOST_DELAY:
        raise ValueError(f"has to list delays of at most {MOST_DELAY} samples")
    if not taps or taps[0] < 0 or list(taps) != sorted(set(taps)):
        raise ValueError("has to list increasing delays >= 0, for example [0, 1]")
    return taps


Taps = Annotated[tuple[int, ...], AfterValidator(_increasing)]


class NarxConfig(Section):
    """Structure of the network; delays count samples.

    `lags` past outputs are fed back. `taps` are the input delays: 0 is the input at the sample
    that is predicted, so (0, 1) needs u(k) and u(k-1); a model that must not use u(k) has taps
    (1, 2). `margin` widens the envelope of the training outputs, as a share of its width, to
    the bounds at which the output is clamped.

    With `moving` > 0 the first so many inputs are increments, which vanish in equilibrium, and the
    network is *anchored*: it subtracts its own value in equilibrium, so that outputs of zero are an
    exact equilibrium wherever the other inputs are constant. With `linear_feedback` past outputs
    reach the linear path alone: an anchored network with its poles inside the unit circle then has
    no other equilibrium.
    """

    lags: int = Field(default=2, ge=1, le=MOST_LAGS)
    taps: Taps = (0, 1)
    hidden: int = Field(default=8, ge=1, le=MOST_HIDDEN)
    margin: float = Field(default=0.25, ge=0)
    moving: int = Field(default=0, ge=0)
    linear_feedback: bool = False
