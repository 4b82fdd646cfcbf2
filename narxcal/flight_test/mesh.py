"""The Citation X mesh: static points and lever disturbances over altitude and lever angle.

Section 2.3 of the Citation X identification paper: accelerated cruise at constant altitude and
throttle lever angle (TLA) for the static model; steps, impulses and ramps of the TLA from trim,
at several altitudes and amplitudes, for the dynamic one; each case marked as identification or
validation. Low and high altitudes are meshed apart, because the TLA range depends on altitude.

The paper's tables of cases (1-4) are images and were not at hand. Known from its text: TLA 50 is
the climb position and the most at 5 000 ft, 35 the least at 45 000 ft; accelerations start at
TLA 25 (low) and 35 (high). Chosen here: the altitudes, steps of 5 deg, a chequerboard of
identification and validation with the corners identified, 45 000 ft as the top, and
`TRA = 85/60 TLA`, which puts the climb position at 71 deg of the 0 .. 85 deg scale.

Modelled: one settled start per case, constant altitude, packs on, standard day. In static cases
Mach grows towards what the lever would hold; in dynamic ones it stays (the paper trims speed,
altitude and TLA). Not modelled: the scatter of altitude that the paper reports at low altitude.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from narxcal.atmosphere import mach_of_cas
from narxcal.flight_test.manoeuvres import Manoeuvre, hold, impulse, ramp, step
from narxcal.flight_test.pilot import Placed, compose
from narxcal.flight_test.route import CHANNEL_NAMES, MACH_MAX, RATE_HZ, check_between
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError

Region = Literal["low", "high"]
Kind = Literal["static", "step", "impulse", "ramp"]
Role = Literal["identification", "validation"]

TRA_PER_TLA = 85.0 / 60.0
TOP_FT = 45_000.0
# The paper's disturbances begin one second into the record; a ramp takes this long.
AFTER_S, RAMP_S = 1.0, 5.0
_STATIC_S, _DYNAMIC_S = 120.0, {"low": 30.0, "high": 45.0}
_ALTITUDES_FT: dict[Region, tuple[float, ...]] = {
    "low": (5e3, 10e3, 15e3, 20e3, 25e3, 30e3),
    "high": (32.5e3, 35e3, 37.5e3, 40e3, 42.5e3, 45e3),
}
_TLA_DEG: dict[Region, tuple[float, ...]] = {
    "low": (25.0, 30.0, 35.0, 40.0, 45.0, 50.0),
    "high": (35.0, 40.0, 45.0, 50.0),
}
_KINDS: tuple[Kind, ...] = ("step", "impulse", "ramp")
_SLOW_KT, _FAST_KT = 200.0, 330.0
_ACCELERATION_S = 50.0


@dataclass(frozen=True)
class Case:
    """One flight test of the mesh; angles are TLA, on the paper's scale.

    `amplitude_deg` is the disturbance (0 for a static case; negative for a deceleration).
    """

    kind: Kind
    region: Region
    alt_ft: float
    tla_deg: float
    amplitude_deg: float
    role: Role

    @property
    def name(self) -> str:
        """Say which case it is, for a file name."""
        start = f"{self.kind}_{self.alt_ft:05.0f}ft_tla{self.tla_deg:g}"
        return f"{start}{self.amplitude_deg:+g}" if self.kind != "static" else start

    def channels(self, rate_hz: float = 32.0) -> dict[str, FloatArray]:
        """Input channels over the case: `time_s`, `TRA_deg` (0 .. 85) and so on, `(time,)` each.

        Raises `ConfigError` for a raster slower than 4 Hz or faster than 256 Hz.
        """
        check_between("rate_hz", rate_hz, *RATE_HZ)
        manoeuvre = self._manoeuvre(1.0 / rate_hz)
        time_s = np.arange(round(manoeuvre.duration_s * rate_hz)) / rate_hz
        channels = {name: np.zeros_like(time_s) for name in CHANNEL_NAMES}
        start_deg = TRA_PER_TLA * self.tla_deg
        return channels | {
            "time_s": time_s,
            "TRA_deg": compose([Placed(0.0, manoeuvre)], time_s, start_deg),
            "ALT_ft": np.full_like(time_s, self.alt_ft),
            "Mach": self._mach(time_s),
            "ECS": np.ones_like(time_s),
        }

    def _manoeuvre(self, sample_s: float) -> Manoeuvre:
        by, then = TRA_PER_TLA * self.amplitude_deg, _DYNAMIC_S[self.region]
        match self.kind:
            case "static":
                return hold(_STATIC_S)
            case "step":
                return step(by, AFTER_S, then)
            case "impulse":
                return impulse(by, sample_s, AFTER_S, then)
            case "ramp":
                return ramp(by, RAMP_S, AFTER_S, then)

    def _mach(self, time_s: FloatArray) -> FloatArray:
        """Mach in time: an accelerated cruise, or the trim of the dynamic cases."""
        slow, held = mach_range(self.alt_ft, self.tla_deg)
        if self.kind != "static":
            return np.full_like(time_s, held)
        return held - (held - slow) * np.exp(-time_s / _ACCELERATION_S)


def mach_range(alt_ft: float, tla_deg: float) -> tuple[float, float]:
    """Mach at which an accelerated cruise begins, and which the lever holds in the end.

    From 200 kt calibrated up to a speed that grows with the lever, at most 330 kt and Mach 0.85.
    """
    slow = float(mach_of_cas(_SLOW_KT, alt_ft))
    most = min(float(mach_of_cas(_FAST_KT, alt_ft)), MACH_MAX)
    least = min(_TLA_DEG["high" if alt_ft > _ALTITUDES_FT["low"][-1] else "low"])
    share = min(max((tla_deg - least) / (50.0 - least), 0.0), 1.0)
    return slow, slow + (0.4 + 0.6 * share) * (most - slow)


def static_mesh(ceiling_ft: float = TOP_FT) -> tuple[Case, ...]:
    """List the static cases up to `ceiling_ft`, identification and validation marked.

    The virtual engine ends at 40 000 ft: pass that as the ceiling to fly them with it.
    Raises `ConfigError` for a ceiling above the mesh, or below all of it.
    """
    return tuple(
        Case("static", region, alt_ft, tla_deg, 0.0, _role(region, (i, j), ceiling_ft))
        for region in _regions()
        for i, alt_ft in enumerate(_below(region, ceiling_ft))
        for j, tla_deg in enumerate(_TLA_DEG[region])
    )


def dynamic_mesh(ceiling_ft: float = TOP_FT, *, decelerations: bool = False) -> tuple[Case, ...]:
    """List the step, impulse and ramp cases, all from the least TLA of their region.

    `decelerations` adds the ways back, which the paper names as future work: from the highest
    TLA reached, downwards by as much. Raises `ConfigError` as `static_mesh`.
    """
    cases = [
        Case(kind, region, alt_ft, start, tla_deg - start, _role(region, (i, j), ceiling_ft))
        for kind in _KINDS
        for region in _regions()
        for i, alt_ft in enumerate(_below(region, ceiling_ft))
        for start in _TLA_DEG[region][:1]
        for j, tla_deg in enumerate(_TLA_DEG[region])
        if j > 0
    ]
    back = [
        Case(c.kind, c.region, c.alt_ft, c.tla_deg + c.amplitude_deg, -c.amplitude_deg, c.role)
        for c in cases
        if decelerations
    ]
    return (*cases, *back)


def _regions() -> tuple[Region, ...]:
    return ("low", "high")


def _role(region: Region, place: tuple[int, int], ceiling_ft: float) -> Role:
    """Chequerboard over altitude and TLA (`place`), with the corners of the mesh identified."""
    i, j = place
    # 1 is the least amplitude of the dynamic cases.
    ends = j in (0, 1, len(_TLA_DEG[region]) - 1)
    corner = ends and i in (0, len(_below(region, ceiling_ft)) - 1)
    return "identification" if corner or (i + j) % 2 == 0 else "validation"


def _below(region: Region, ceiling_ft: float) -> tuple[float, ...]:
    lowest = _ALTITUDES_FT["low"][0]
    if not lowest <= ceiling_ft <= TOP_FT or math.isnan(ceiling_ft):
        raise ConfigError(
            f"the mesh goes from {lowest:g} to {TOP_FT:g} ft, and its ceiling should be "
            f"{ceiling_ft:g} ft"
        )
    return tuple(alt_ft for alt_ft in _ALTITUDES_FT[region] if alt_ft <= ceiling_ft)
