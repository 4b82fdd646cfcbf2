"""Output error on logs with a steady-state model in front."""

from dataclasses import dataclass

import numpy as np
import pytest

from data_prep.log import Log
from narxcal.output_error.engine import EngineFromSteady
from narxcal.support.errors import DataError
from training.papers.identify import OFFSETS, steady_record
from training.papers.output_error import Plan, fit

TRUE = {
    "tau_H": 0.9, "tau_L": 1.4, "alpha": 0.6, "tau_T": 2.0, "beta": 2.5, "rate_H": 0.03,
    "rate_L": 0.02, "N_HO": 0.1, "N_LO": -0.2, "T_O": 3.0, "tau_M": 0.4, "square_M": 0.0,
}  # fmt: skip


@dataclass(frozen=True)
class Curves:
    """Steady N2, N1, EGT over fuel flow, curved."""

    input_names: tuple = ("FF_kgph",)
    output_names: tuple = ("N1_pct", "N2_pct", "EGT_C")

    def outputs(self, inputs):
        x = inputs[..., 0] / 600.0
        return np.stack([100 * x**0.6, 50 + 45 * x**0.5, 350 + 300 * x], axis=-1)

    def inside(self, inputs):
        return np.ones(len(inputs), dtype=bool)


def made_log(seed=0, points=6000):
    rng = np.random.default_rng(seed)
    levels = rng.uniform(100, 600, points // 100 + 1)
    fuel = np.interp(np.arange(points), np.arange(len(levels)) * 100 + 50, levels)
    log = Log("log", np.arange(points) * 0.1, {"FF_kgph": fuel} | dict.fromkeys(
        ("N1_pct", "N2_pct", "EGT_C"), np.zeros(points)))  # fmt: skip
    u = steady_record(log, Curves(), "FF_kgph").u
    N2, N1, T = EngineFromSteady(0.1).simulate(TRUE, u).T
    noise = rng.normal(size=(3, points)) * np.array([[0.1], [0.1], [1.0]])
    return log.with_channels({
        "N2_pct": N2 + noise[0], "N1_pct": N1 + noise[1], "EGT_C": T + noise[2]
    })  # fmt: skip


def test_slopes_are_those_of_the_steady_curves():
    record = steady_record(made_log(), Curves(), "FF_kgph")
    x = made_log()["FF_kgph"] / 600.0
    np.testing.assert_allclose(record.u[:, 3], 60 * x**-0.4 / (22.5 * x**-0.5), rtol=0.01)
    np.testing.assert_allclose(record.u[:, 4], 300.0 / (22.5 * x**-0.5), rtol=0.02)
    assert record.y.shape == (6000, 3)


@pytest.mark.slow
def test_dynamics_and_meter_come_back_from_a_log():
    model = EngineFromSteady(0.1)
    free = tuple(one.name for one in model.parameters if one.free or one.name in OFFSETS)
    plan = Plan(free=(*free, "tau_M"), iterations=100)
    found = fit(model, [steady_record(made_log(), Curves(), "FF_kgph")], plan)
    for name, (value, sd) in found.estimates().items():
        assert abs(value - TRUE[name]) < 4.0 * sd, name


def test_a_channel_that_is_not_there_is_named():
    @dataclass(frozen=True)
    class Speeds(Curves):
        output_names: tuple = ("N1_pct", "N2_pct")

    with pytest.raises(DataError) as error:
        steady_record(made_log(), Speeds(), "FF_kgph")
    assert str(error.value) == (
        "log, channel EGT_C: the steady-state model does not give this output. Output error needs "
        "N2_pct, N1_pct, EGT_C: choose another method"
    )
    short = Log("log", np.arange(9.0), {"FF_kgph": np.arange(9.0)})
    with pytest.raises(DataError) as error:
        steady_record(short, Curves(), "FF_kgph")
    assert str(error.value) == ("log, channel N2_pct: the log has no such channel. It has FF_kgph")
