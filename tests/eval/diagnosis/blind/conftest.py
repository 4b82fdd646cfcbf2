"""An engine of three lags in the place of the virtual one: a case in a blink."""

import shutil
from dataclasses import dataclass
from types import SimpleNamespace

import pytest

from eval.diagnosis.blind import files, truth
from eval.diagnosis.blind.cases import BlindPlan
from eval.diagnosis.blind.make import make_cases, write_key
from eval.diagnosis.blind.outcome import Outcome
from narxcal.flight_test.signals import first_order
from narxcal.turbofan.engine import INPUT_NAMES


class Body(SimpleNamespace):
    def _replace(self, **changes):
        return Body(**{**vars(self), **changes})


@dataclass
class Fit:
    body: Body


class LagEngine:
    """Knows some of the effects; the others change nothing but the fuel flow."""

    input_names = INPUT_NAMES

    def __init__(self, name="business_jet", build=None, unmodelled=()):
        self.name = name
        self.settings = Fit(Body(probe_tau_s=0.7))
        self.worth = 1.0 if build is None else build.hpt_efficiency
        self.effects = {effect.id: effect for effect in unmodelled}

    def of(self, effect, parameter, neutral):
        found = self.effects.get(effect)
        return neutral if found is None else found.parameters.get(parameter, neutral)

    def simulate(self, inputs, dt_s):
        lever = inputs["TRA_deg"] / 85.0 + self.of("throttle_bias", "bias_deg", 0.0) / 85.0
        lever = first_order(lever, 3.0 * self.of("throttle_delay", "delay_s", 0.0), dt_s)
        tau_s = 1.5 * self.of("spool_lag", "factor", 1.0)
        power = first_order(lever, tau_s, dt_s)
        known = ("throttle_bias", "throttle_delay", "spool_lag", "heat_soak")
        more = sum(
            abs(value)
            for name, effect in self.effects.items()
            if name not in known
            for value in effect.parameters.values()
        )
        return {
            "N1_pct": 25.0 + 70.0 * power,
            "N2_pct": 55.0 + 40.0 * power * self.worth,
            "EGT_C": 400.0 + 350.0 * first_order(power, self.settings.body.probe_tau_s, dt_s),
            "FF_kgph": 100.0 + (400.0 + 10.0 * more) * power,
        }


@pytest.fixture(scope="session", autouse=True)
def quick_seal():
    """A thousandth of the rounds that make a secret hard to guess."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(files, "_ROUNDS", 200)
        yield


@pytest.fixture
def quick(monkeypatch):
    monkeypatch.setattr(truth, "VirtualEngine", LagEngine)


@pytest.fixture(scope="session")
def plan():
    return BlindPlan(cases=3, flights=2, held_out=1, rate_hz=8.0, seed=4)


@pytest.fixture(scope="session")
def made_once(plan, quick_seal, tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(truth, "VirtualEngine", LagEngine)
        write_key(folder, plan, "4", make_cases(folder, plan))
    return folder


@pytest.fixture
def made(quick, made_once, tmp_path):
    """A copy of the cases, to do with as a test likes."""
    return shutil.copytree(made_once, tmp_path / "cases")


def truth_row(kind="single", effects=("spool_lag",), gap_share=0.2, like=(), budget=None):
    channels = {"N1_pct": 0.8, "EGT_C": 0.2}
    families = {"spool_lag": "transit", "sensor_lag:EGT_C": "channel lag"}
    rows = []
    for name in effects:
        effect, _, channel = name.partition(":")
        rows.append({"id": effect, "channel": channel or None, "family": families.get(name, "-")})
    outside = {"id": "map_kink", "size": 1.0, "like": list(like)} if kind == "outside" else None
    return {
        "kind": kind,
        "style": "line",
        "engine": "business_jet",
        "effects": rows,
        "outside": outside,
        "base": {"differs": True},
        "gap_share": gap_share,
        "budget": budget or {n: {"share": 0.5, "channels": channels} for n in effects},
    }


def answer_row(kind="effects", effects=("spool_lag",), rivals=(), listed=None, **more):
    listed = listed or {"spool_lag": 0.9, "sensor_lag:EGT_C": 0.1}
    rows = []
    for name, probability in listed.items():
        effect, _, channel = name.partition(":")
        row = {"id": effect, "probability": probability}
        rows.append(row | ({"channel": channel} if channel else {}))
    return {
        "schema": "narxcal.gap/2",
        "verdict": {
            "kind": kind,
            "effects": list(effects),
            "ambiguous_with": list(rivals),
            "reason": "so it is",
        },
        "effects": rows,
        "where": [
            {"channel": "N1_pct", "direction": "push", "phase": "transit", "share": 0.6},
            {"channel": "N1_pct", "direction": "pull", "phase": "transit", "share": 0.4},
        ],
        "shrink": {"predicted": {"value": 0.8, "low": 0.7, "high": 0.9}, "realised": 0.75},
        "seconds": 12.0,
        **more,
    }


@pytest.fixture
def outcome():
    def build(truth=None, answer=None, name="case_001"):
        return Outcome(name, truth_row(**(truth or {})), answer or answer_row())

    return build


@pytest.fixture
def answer():
    return answer_row
