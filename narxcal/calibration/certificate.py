"""Does a calibration settle at constant inputs? Poles over the box of its inputs, and long holds.

| form | settles |
|---|---|
| lags, limited or governed | by construction (`narxcal.lumped`) |
| network behind lags | by its decay bound (`settle_s`) |
| response of first or second order | by construction: exp(...) are times, damping, frequency |
| steady state, first-order lag | by construction |
| ARX, output error of `training.dynamics.baselines` | by construction, with unit gain |
| state space, output-error engine, other networks | if it is found here |

Inputs saturate in the box `Calibration.reach`, so that what holds there holds for all inputs. At
points of the box, its corners first, the poles of the linearised step have to lie inside the unit
circle; and a run that steps from point to point, far ones in turn, and stays ten time constants of
the slowest pole at each (`HOLD_S` at least), may move by at most `SWING` of an output's largest
steady value in the last sixth of each stay; where ten time constants would take too long, by that
much back and forth. A certificate is evidence, no proof: both are samples.
Where a model comes to rest is a second figure: networks without an anchor have equilibria of their
own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from typing import Annotated, Any, Final

import numpy as np
from pydantic import BeforeValidator

from narxcal.calibration.calibration import Calibration
from narxcal.calibration.dynamic import DynamicCalibration
from narxcal.calibration.members import Member
from narxcal.channels import CHANNELS
from narxcal.steady.model import ALTERED, Envelope, envelope_of
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ModelError

HOLD_S: Final = 300.0
_LONGEST_S: Final = 1500.0  # ten of the longest time constant of heat; a control's may be longer
_ROUNDING: Final = 2.0**-26  # to which the modulus of a double pole is known
SWING: Final = 0.002
_LAST: Final = 1.0 / 6.0  # of a stay, in which it may move by `SWING` at most
_CORNERS, _INSIDE = 16, 16  # points at most
# Decay bound of a network that does not settle: 2 exp(-250 / 30) of the largest move is left when
# the end of a stay begins, a quarter of `SWING`.
_DECAY_S = 30.0


# JSON has no number for what is not finite: it is null there.
_Unbounded = Annotated[float, BeforeValidator(lambda found: np.inf if found is None else found)]


@dataclass(frozen=True)
class Certificate:
    """What was found: largest pole (modulus per sample), swing and offset of each output.

    `swing` and `offset` are shares of the output's largest steady value, at the end of the worst
    stay. `at` are the inputs of the worst swing, `pole_at` those of the largest pole.
    """

    pole: _Unbounded
    pole_at: Mapping[str, float]
    swing: Mapping[str, _Unbounded]
    offset: Mapping[str, _Unbounded]
    at: Mapping[str, float]
    dt_s: float
    points: int
    hold_s: float

    def __post_init__(self) -> None:
        if not self.swing or not self.pole >= 0.0:
            raise ModelError("the stored certificate is of no output", hint=ALTERED)

    @property
    def settled(self) -> bool:
        """Whether all poles lie inside the unit circle and nothing moves at the end of a stay."""
        return self.pole < 1.0 - _ROUNDING and max(self.swing.values()) <= SWING

    @property
    def slowest_s(self) -> float:
        """Time constant of the largest pole; infinite from 1 on."""
        if self.pole >= 1.0:
            return float("inf")
        return float(-self.dt_s / np.log(max(self.pole, 1e-300)))

    @property
    def words(self) -> str:
        if self.settled:
            return (
                f"settles at constant inputs: {self.points} points held {self.hold_s:.0f} s, "
                f"slowest time constant {self.slowest_s:.3g} s"
            )
        name = max(self.swing, key=lambda one: self.swing[one])
        where = ", ".join(f"{key} {value:.4g}" for key, value in self.at.items())
        if self.swing[name] > SWING:
            return (
                f"does not settle at constant inputs: {name} still swings by "
                f"{100.0 * self.swing[name]:.3g} % of full scale after {self.hold_s:.0f} s "
                f"at {where}"
            )
        where = ", ".join(f"{key} {value:.4g}" for key, value in self.pole_at.items())
        return f"is unstable at {where}: a pole of {self.pole:.6f} per sample"

    def row(self) -> dict[str, Any]:
        slowest_s = self.slowest_s if np.isfinite(self.slowest_s) else None
        return {"settled": self.settled, "slowest_s": slowest_s, **asdict(self)}


def certify(model: Calibration) -> Certificate:
    """Look for a constant input at which `model` does not settle.

    Its box is `reach`, else the envelope of the steady state, else the channels' physical ranges.
    The result does not depend on chance.
    """
    names, points = model.input_names, _points(_box(model))
    ss = model.steady.outputs(points)
    poles = [np.abs(model.poles(point)).max(initial=0.0) for point in points]
    pole = float(max(poles))
    slowest_s = -model.dt_s / np.log(pole) if 0.0 < pole < 1.0 else 0.0
    hold_s = float(np.clip(10.0 * slowest_s, HOLD_S, _LONGEST_S))
    steady = 10.0 * slowest_s <= hold_s
    swing, offset = _held(model, points, ss, hold_s, steady=steady)
    scale = np.maximum(np.abs(ss).max(axis=0), 1e-9)
    swing, offset = swing / scale, offset / scale
    worst, slow = int(swing.max(axis=1).argmax()), int(np.argmax(poles))
    return Certificate(
        pole,
        dict(zip(names, points[slow].tolist(), strict=True)),
        dict(zip(model.output_names, swing.max(axis=0).tolist(), strict=True)),
        dict(zip(model.output_names, offset.max(axis=0).tolist(), strict=True)),
        dict(zip(names, points[worst].tolist(), strict=True)),
        model.dt_s,
        len(points),
        hold_s,
    )


def settling(
    model: Calibration, simple: Sequence[Member]
) -> tuple[Calibration, Certificate, tuple[str, ...]]:
    """Return what of `model` settles, its certificate, and a sentence for each part given up.

    A network that does not settle gets a decay bound, if it is an anchored one without; if that is
    not enough, the models `simple` of the outputs lead. Any other model stays, with a sentence.
    """
    found, lost = certify(model), []
    if not isinstance(model, DynamicCalibration):
        return model, found, () if found.settled else (f"the model {found.words}",)
    if not found.settled and model.settle_s is None and model.narx.config.moving > 0:
        lost.append(f"the network {found.words}: it has a decay bound of {_DECAY_S:g} s now")
        model = model.with_decay(_DECAY_S)
        found = certify(model)
    if not found.settled:
        lost.append(f"the model {found.words}: first-order lags take its place")
        model = model.with_members(simple)
        found = certify(model)
    return model, found, tuple(lost)


def _held(
    model: Calibration, points: FloatArray, ss: FloatArray, hold_s: float, *, steady: bool
) -> tuple[FloatArray, FloatArray]:
    """Swing and offset (points, n_out) at the ends of stays; what is not finite is infinite.

    Of a model that need not be `steady` by then the way from first to last sample is no swing.
    """
    steps = max(round(hold_s / model.dt_s), 12)
    order = np.repeat(np.arange(len(points)), steps)
    far = ss[0] + 0.5 * np.ptp(ss, axis=0)
    with np.errstate(all="ignore"):
        y = model.run(points[order], ss[order], far).reshape(len(points), steps, -1)
        end = y[:, -max(round(_LAST * steps), 2) :]
        swing, offset = np.ptp(end, axis=1), np.abs(end.mean(axis=1) - ss)
        swing -= 0.0 if steady else np.abs(end[:, -1] - end[:, 0])
    return np.nan_to_num(swing, nan=np.inf), np.nan_to_num(offset, nan=np.inf)


def _box(model: Calibration) -> Envelope:
    if model.reach is not None:
        return model.reach
    known = [CHANNELS.get(name) for name in model.input_names]
    low = np.array([0.0 if one is None else one.low for one in known])
    high = np.array([0.0 if one is None else one.high for one in known])
    box = envelope_of(model.steady)
    return Envelope(
        np.where(np.isfinite(box.low), box.low, low),
        np.where(np.isfinite(box.high), box.high, high),
    )


def _points(box: Envelope) -> FloatArray:
    """Points (n, n_in), a far one after each: corners, then an even sequence inside.

    The sequence is the additive recurrence of the generalised golden ratio (Roberts, 2018).
    """
    count = len(box.low)
    if count < 5:
        corners = np.array(list(product((0.0, 1.0), repeat=count)))
    else:
        corners = np.random.default_rng(0).integers(0, 2, (_CORNERS, count)).astype(np.float64)
    ratio = 2.0
    for _ in range(50):
        ratio = (1.0 + ratio) ** (1.0 / (count + 1.0))
    steps = ratio ** -np.arange(1.0, count + 1.0)
    inside = (0.5 + np.arange(_INSIDE)[:, None] * steps) % 1.0
    share = np.concatenate([corners, inside])
    share = share[np.argsort(share[:, 0], kind="stable")]
    half = len(share) // 2
    turned = np.empty_like(share)  # low and high values of the first input in turn
    turned[0::2], turned[1::2] = share[: len(share) - half], share[len(share) - half :]
    found: FloatArray = box.low + turned * (box.high - box.low)
    return found
