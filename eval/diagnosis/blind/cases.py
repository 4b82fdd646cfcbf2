"""The cases of a blind test: effects by one size each, and what is drawn of them.

Of all cases at least a fifth hold nothing but build scatter and structural misfit, 15 % something
out of the library, half of that mimics, and 15 % two effects; the rest hold one, the catalogue
in turn, in four sizes by the share of the squared gap that it makes. Effects in an engine act in
its physics, those of a sensor in its measurement chain: neither is a form that the diagnosis fits.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from pydantic import Field

from eval.diagnosis.blind.lumped import KINDS, applies
from eval.diagnosis.blind.outside import MIMICS, OTHERS, Strange
from narxcal.effects.library import LIBRARY
from narxcal.flight_test.scenario import PARAMETERS
from narxcal.flight_test.sensors import PARAMETERS as ON_SENSORS
from narxcal.flight_test.sensors import SensorFault
from narxcal.support.settings import Section
from narxcal.turbofan import Unmodelled

Windows = tuple[tuple[float, float], ...]
# Fuel flow (kg/h) at which the flow meter's time constant holds, about half of take-off.
_METER_KGPH: Final = {"single_aisle": 2000.0}
_SMALL_KGPH: Final = 300.0


class Scale(NamedTuple):
    """One effect by one size: each parameter is `neutral + factor * size`.

    `first` is the size to try first, `most` the largest, in the unit of the first parameter;
    `signed` effects go both ways. `inverse` is a limit that gets narrower as the size grows.
    """

    id: str
    factors: Mapping[str, float]
    first: float
    most: float
    channel: str | None = None
    signed: bool = False
    inverse: bool = False

    @property
    def name(self) -> str:
        return self.id if self.channel is None else f"{self.id}:{self.channel}"

    @property
    def family(self) -> str:
        return LIBRARY[self.id].family

    def parameters(self, size: float) -> dict[str, float]:
        if self.inverse:
            return {name: factor / size for name, factor in self.factors.items()}
        sizes = PARAMETERS[self.id]
        return {name: sizes[name].neutral + factor * size for name, factor in self.factors.items()}


CATALOGUE: Final = (
    Scale("throttle_backlash", {"width_deg": 1.0}, 1.0, 8.0),
    Scale("throttle_delay", {"delay_s": 1.0}, 0.15, 2.0),
    # The size is the time that 10 degrees take.
    Scale("throttle_rate_limit", {"rate_degps": 10.0}, 1.0, 6.0, inverse=True),
    Scale("throttle_bias", {"bias_deg": 1.0}, 0.7, 6.0, signed=True),
    Scale("actuator_lag", {"tau_s": 1.0}, 0.3, 3.0),
    Scale("spool_lag", {"factor": 1.0}, 0.25, 2.5),
    Scale("accel_decel_asymmetry", {"ratio": 1.0}, 0.3, 2.5),
    Scale("accel_limit", {"factor": -1.0}, 0.3, 0.8),
    Scale("altitude_lag", {"exponent": 1.0}, 0.4, 1.9),
    Scale("spool_coupling", {"factor": 1.0}, 0.3, 2.5),
    Scale("heat_soak", {"factor": 1.0}, 1.0, 4.0),
    Scale("bleed_extraction", {"share": 1.0}, 0.01, 0.12),
    Scale("unlogged_switch", {"bleed": 1.0}, 0.015, 0.12),
    Scale("deterioration", {"hpt_efficiency_pct": 1.0, "hpc_efficiency_pct": 0.6}, 1.0, 5.0),
    Scale("temperature_effect", {"N1_pct_per_C": 1.0}, 0.05, 0.28, signed=True),
    Scale("idle_schedule", {"shift_pct": 1.0}, 2.0, 12.0),
    Scale("sensor_lag", {"tau_s": 1.0}, 0.5, 6.0, channel="EGT_C"),
    Scale("sensor_lag", {"tau_s": 1.0}, 0.3, 4.0, channel="N2_pct"),
    Scale("sensor_lag", {"tau_s": 1.0}, 0.3, 4.0, channel="N1_pct"),
    Scale("sensor_bias", {"offset": 1.0}, 6.0, 60.0, channel="EGT_C", signed=True),
    Scale("sensor_bias", {"offset": 1.0}, 0.6, 6.0, channel="N2_pct", signed=True),
    Scale("sensor_drift", {"rate_per_h": 1.0}, 80.0, 900.0, channel="EGT_C", signed=True),
    Scale("sensor_drift", {"rate_per_h": 1.0}, 8.0, 90.0, channel="N2_pct", signed=True),
    Scale("sensor_bias", {"offset": 1.0}, 0.6, 6.0, channel="N1_pct", signed=True),
    Scale("time_skew", {"skew_s": 1.0}, 0.15, 1.5, channel="N2_pct"),
    Scale("time_skew", {"skew_s": 1.0}, 0.3, 1.5, channel="EGT_C"),
    Scale("flowmeter_dynamics", {"tau_s": 1.0}, 0.4, 4.0, channel="FF_kgph"),
)


class Dose(NamedTuple):
    """An effect of a size."""

    scale: Scale
    size: float

    @property
    def parameters(self) -> dict[str, float]:
        return self.scale.parameters(self.size)

    @property
    def on_sensor(self) -> bool:
        """Whether it acts on a recording; else it acts on an engine."""
        return self.scale.id in ON_SENSORS

    def unmodelled(self, windows: Windows) -> Unmodelled:
        own = windows if self.scale.id == "unlogged_switch" else ()
        return Unmodelled(self.scale.id, self.parameters, own)

    def row(self) -> dict[str, Any]:
        return {
            "id": self.scale.id,
            "channel": self.scale.channel,
            "family": self.scale.family,
            "parameters": self.parameters,
        }

    def fault(self, engine: str) -> SensorFault:
        more = {}
        if self.scale.id == "flowmeter_dynamics":
            more = {"reference_kgph": _METER_KGPH.get(engine, _SMALL_KGPH)}
        return SensorFault(self.scale.id, self.scale.channel or "", {**self.parameters, **more})


Kind = Literal["single", "pair", "null", "outside"]
STYLES: Final = ("line", "enriched")
BINS: Final = ((0.02, 0.05), (0.05, 0.10), (0.10, 0.25), (0.25, 0.95))
OFFSETS: Final = ("deterioration", "sensor_bias", "throttle_bias", "temperature_effect")
_OF_OFFSETS: Final = (0.9, 0.98)
# Beside white noise alone the least that can be named is small, and a plain effect is nearly all.
_OWN_BINS: Final = ((0.05, 0.25), (0.25, 0.75), (0.75, 0.95), (0.95, 0.998))
_NULLS, _OUTSIDE, _PAIRS = 0.2, 0.16, 0.16
_BUILD_PCT, _NULL_BUILD_PCT = 0.6, 0.8  # standard deviation of efficiencies and flows


class BlindPlan(Section):
    """What to make: `cases` of `flights` of `duration_s` to answer, and `held_out` to check on.

    `rate_hz` is that of the logs. `engine` restricts the engines: of all, about a third of the
    cases fly a lumped one. With `build` "same" the recorded engine is the simulator's own in all
    but what a case holds, and its sensors add white noise alone, as where a simulator's maker
    records what it says.
    """

    cases: int = Field(default=60, ge=1, le=9999)
    flights: int = Field(default=6, ge=1, le=60)
    held_out: int = Field(default=2, ge=1, le=60)
    duration_s: float = Field(default=480.0, ge=480.0, le=43_200.0)
    rate_hz: float = Field(default=32.0, ge=5.0, le=256.0)
    style: Literal["line", "enriched", "both"] = "both"
    engine: Literal["virtual", "lumped", "all"] = "all"
    build: Literal["scattered", "same"] = "scattered"
    seed: int = Field(default=0, ge=0)


class Base(NamedTuple):
    """How simulator and real engine differ besides the effect.

    Each factor is the simulator's over the real engine's; `misfit` says whether the real engine
    has another structure as well. `build_pct` is its scatter against the simulator.
    """

    build_pct: float
    soak: float = 1.0
    probe: float = 1.0
    inertia: float = 1.0
    misfit: bool = False

    @property
    def differs(self) -> bool:
        """Whether parameters or structure differ, build scatter aside."""
        return self.misfit or (self.soak, self.probe, self.inertia) != (1.0, 1.0, 1.0)


class Case(NamedTuple):
    """One case before its sizes are known; `share` is the share of the gap to aim at."""

    name: str
    number: int
    kind: Kind
    style: str
    engine: str
    base: Base
    effects: tuple[Scale, ...] = ()
    signs: tuple[float, ...] = ()
    strange: Strange | None = None
    share: float = 0.0


class Content(NamedTuple):
    """What a case is to hold: `bin` is the group of sizes to draw from."""

    kind: Kind
    effects: tuple[Scale, ...] = ()
    strange: Strange | None = None
    bin: int = 0


class Offer(NamedTuple):
    """What cases can be made of: effects, and what looks like one; of one `engine`, if given."""

    scales: tuple[Scale, ...] = CATALOGUE
    mimics: tuple[Strange, ...] = MIMICS
    engine: str | None = None


def drawn(plan: BlindPlan, *purpose: int) -> np.random.Generator:
    """Random numbers of a plan for one purpose alone."""
    return np.random.default_rng(np.random.SeedSequence(plan.seed, spawn_key=purpose))


def case_name(plan: BlindPlan, number: int) -> str:
    """`case_001` and on, with as many digits as the last one needs."""
    return f"case_{number:0{max(3, len(str(plan.cases)))}d}"


def draw_cases(plan: BlindPlan, offer: Offer | None = None) -> list[Case]:
    """Draw all cases of a plan, in an order that tells nothing about them."""
    offer = offer or Offer()
    random = drawn(plan, 0 if offer.engine is None else 3)
    contents = draw_contents(plan.cases, random, offer)
    order = random.permutation(len(contents)).tolist()
    return [
        _case((number, which), plan, contents[which], offer.engine, random)
        for number, which in enumerate(order, start=1)
    ]


def _case(
    numbers: tuple[int, int],
    plan: BlindPlan,
    content: Content,
    engine: str | None,
    random: np.random.Generator,
) -> Case:
    number, which = numbers
    styles = STYLES if plan.style == "both" else (plan.style,)
    own = engine is None
    return Case(
        name=case_name(plan, number),
        number=number,
        kind=content.kind,
        effects=content.effects,
        # In this order, for each draws from `random`.
        signs=tuple(
            float(random.choice((-1.0, 1.0))) if e.signed else 1.0 for e in content.effects
        ),
        style=engine or styles[(which + which // len(CATALOGUE)) % len(styles)],
        engine=engine or _engine(plan.engine, which, content, random),
        base=base_of(plan, content.kind, which, random if own else None),
        strange=content.strange,
        share=draw_share(content, random, plan.build),
    )


def _engine(wanted: str, which: int, content: Content, random: np.random.Generator) -> str:
    """A lumped engine in every third case, of a kind that has a place for all effects."""
    preset = "single_aisle" if random.uniform() < 0.25 else "business_jet"
    kinds = [kind for kind in KINDS if all(applies(e.id, kind) for e in content.effects)]
    lumped = kinds[int(random.integers(len(kinds)))]
    third = (which + which // 3 + which // 9) % 3 == 0
    return lumped if wanted == "lumped" or (wanted == "all" and third) else preset


def draw_share(content: Content, random: np.random.Generator, build: str) -> float:
    """Draw the share of the gap that the content makes; nothing makes none.

    The energy of the effect over that of the rest is log-uniform.
    An offset is most of the gap: a smaller one drowns in the offsets of build and instrumentation,
    and nobody could name it, where there are any.
    """
    if content.kind == "null":
        return 0.0
    bins = _OWN_BINS if build == "same" else BINS
    offset = build != "same" and any(effect.id in OFFSETS for effect in content.effects)
    bounds = _OF_OFFSETS if offset else bins[content.bin]
    low, high = (math.log(share / (1.0 - share)) for share in bounds)
    odds = math.exp(random.uniform(low, high))
    return odds / (1.0 + odds)


def base_of(plan: BlindPlan, kind: Kind, which: int, random: np.random.Generator | None) -> Base:
    """Nulls always, and every other of the rest, have a simulator that is wrong.

    Without `random` numbers, as of logs, in its structure alone.
    """
    if plan.build == "same":
        return Base(0.0)
    wrong = kind == "null" or which % 2 == 0
    if random is None:
        return Base(0.0, misfit=wrong)
    if not wrong:
        return Base(_BUILD_PCT)
    return Base(
        _NULL_BUILD_PCT if kind == "null" else _BUILD_PCT,
        soak=float(random.uniform(0.85, 1.15)),
        probe=float(random.uniform(0.94, 1.06)),
        inertia=float(random.uniform(0.985, 1.015)),
        misfit=True,
    )


def draw_contents(cases: int, random: np.random.Generator, offer: Offer) -> list[Content]:
    """What the cases hold; shares are rounded up, as long as there are enough cases."""
    nulls = math.ceil(_NULLS * cases)
    outside = min(math.ceil(_OUTSIDE * cases), cases - nulls)
    pairs = min(math.ceil(_PAIRS * cases), cases - nulls - outside)
    singles = cases - nulls - outside - pairs
    found = [Content("null") for _ in range(nulls)]
    found += [_strange(k, offer) for k in range(outside)]
    found += [
        Content("pair", _two(offer.scales, random), bin=3 if k % 3 else 2) for k in range(pairs)
    ]
    return found + _singles(singles, offer.scales, random)


def _strange(number: int, offer: Offer) -> Content:
    """Mimics and others in turn, of at least 5 %."""
    group = (offer.mimics, OTHERS)[number % 2]
    return Content("outside", strange=group[number // 2 % len(group)], bin=1 + number % 3)


def _singles(count: int, scales: Sequence[Scale], random: np.random.Generator) -> list[Content]:
    """The catalogue in turn, in an order of its own each time, the sizes in turn as well."""
    found: list[Content] = []
    while len(found) < count:
        start = len(found) // len(scales)
        order: Iterable[int] = random.permutation(len(scales)).tolist()
        found += [
            Content("single", (scales[index],), bin=(start + index) % len(BINS)) for index in order
        ]
    return found[:count]


def _two(scales: Sequence[Scale], random: np.random.Generator) -> tuple[Scale, ...]:
    while True:
        first, second = (scales[k] for k in random.choice(len(scales), 2, replace=False))
        if first.family != second.family:
            return first, second
