"""Identified dynamics behind a steady state: one sample, a block, a whole log; bundles."""

import json
from dataclasses import replace

import numpy as np
import pytest

from narxcal import Bundle, load_bundle, save_bundle
from narxcal.calibration.folder import seal
from narxcal.calibration.identified import (
    EngineDynamics,
    IdentifiedCalibration,
    NoDynamics,
    ResponseDynamics,
    StateSpaceDynamics,
)
from narxcal.output_error.engine import EngineFromSteady
from narxcal.state_space import StateSpace
from narxcal.static_models import mattingly
from narxcal.static_models.model import StaticLaws
from narxcal.steady.model import Envelope
from narxcal.steady.table import SteadyTable
from narxcal.support.errors import ModelError
from narxcal.support.files import to_json
from narxcal.transfer import Schedule

DT = 0.1
NAMES = (("TRA_deg", "ALT_ft"), ("N1_pct", "N2_pct", "EGT_C"))
RNG = np.random.default_rng(0)
LOG = np.column_stack([
    np.repeat(RNG.uniform(10.0, 70.0, 20), 20) + RNG.normal(0.0, 0.1, 400),
    np.linspace(0.0, 20e3, 400),
])  # fmt: skip


def steady():
    points = np.array([[0.0, 0.0], [0.0, 30e3], [80.0, 0.0], [80.0, 30e3]])
    columns = [
        20 + points[:, 0],
        50 + 0.6 * points[:, 0],
        400 + 5 * points[:, 0] + points[:, 1] / 1e3,
    ]
    return SteadyTable(NAMES, points, np.column_stack(columns))


def engine():
    values = {one.name: one.start for one in EngineFromSteady(DT).parameters}
    values |= {"tau_M": 0.3, "alpha": 0.4, "beta": 1.7}
    return EngineDynamics(values, ("tau_H", "tau_L"), "TRA_deg", (10.0, 70.0), (1, 0, 2), DT)


def responses():
    over = Schedule(((20.0, 90.0), (0.0, 20e3)), np.log(RNG.uniform(0.5, 2.0, (2, 2, 2))))
    first = Schedule(((20.0, 90.0), (0.0, 20e3)), np.log(RNG.uniform(0.5, 2.0, (2, 2, 1))))
    return ResponseDynamics(("level", "ALT_ft"), (over, first, over), DT)


def state_space():
    A = np.diag([0.95, 0.8, 0.6, 0.9])
    return StateSpaceDynamics(
        StateSpace(A, RNG.normal(size=(4, 3)), RNG.normal(size=(3, 4)), np.zeros((3, 3)), DT)
    )


KINDS = {"none": NoDynamics, "engine": engine, "responses": responses, "state space": state_space}


@pytest.fixture(params=KINDS)
def model(request):
    return IdentifiedCalibration(steady(), KINDS[request.param](), DT)


def test_samples_blocks_and_the_whole_log_are_the_same(model):
    start = model.steady.outputs(LOG[0]) + np.array([3.0, -2.0, 10.0])
    whole = model.simulate(LOG, start)
    samples = [model.reset(LOG[0], start), *(model.step(row) for row in LOG[1:])]
    np.testing.assert_allclose(samples, whole, atol=1e-9)
    model.reset(LOG[0], start)
    blocks = np.concatenate([model.extend(LOG[1:7]), model.extend(LOG[7:])])
    np.testing.assert_allclose(blocks, whole[1:], atol=1e-9)


def test_the_one_step_prediction_is_a_step_from_the_measured_sample(model):
    measured = model.steady.outputs(LOG) + RNG.normal(size=(len(LOG), 3))
    measured[50, 1] = np.nan
    predicted = model.predict(LOG, measured)
    assert np.isnan(predicted[0]).all()
    assert np.isnan(predicted[51]).all()
    model.reset(LOG[0])
    steps = [model.step(row, z) for row, z in zip(LOG[1:], measured[:-1], strict=True)]
    known = np.isfinite(predicted[1:])
    np.testing.assert_allclose(np.array(steps)[known], predicted[1:][known], atol=1e-9)


def test_a_constant_input_ends_in_the_steady_state(model):
    still = np.tile(LOG[0], (3000, 1))
    outputs = model.simulate(still, model.steady.outputs(LOG[0]) + 5.0)
    np.testing.assert_allclose(outputs[-1], model.steady.outputs(LOG[0]), atol=1e-6)


def test_a_bundle_gives_the_same_numbers(model, tmp_path):
    save_bundle(tmp_path / "run", Bundle(model))
    loaded = load_bundle(tmp_path / "run").calibration
    np.testing.assert_array_equal(loaded.simulate(LOG), model.simulate(LOG))
    assert (loaded.words, loaded.size) == (model.words, model.size)


def test_an_output_that_the_engine_does_not_have_is_steady():
    names, deck = NAMES[1], steady()
    more = SteadyTable(
        (NAMES[0], ("FF_kgph", *names)),
        deck.points,
        np.hstack([100.0 + deck.points[:, :1], deck.values]),
    )
    own = replace(engine(), order=(2, 1, 3))
    model, without = (IdentifiedCalibration(*each, DT) for each in ((more, own), (deck, engine())))
    start = model.steady.outputs(LOG[0]) + 5.0
    found = model.simulate(LOG, start)
    np.testing.assert_allclose(found[1:, 0], model.steady.outputs(LOG)[1:, 0], atol=1e-12)
    np.testing.assert_array_equal(found[:, 1:], without.simulate(LOG, start[1:]))


def test_the_engine_is_that_of_the_fit():
    model = IdentifiedCalibration(steady(), engine(), DT)
    drive = model.dynamics.drive(model.steady, LOG, model.steady.outputs(LOG))
    own = EngineFromSteady(DT).simulate(model.dynamics.values, drive)
    np.testing.assert_allclose(model.simulate(LOG)[:, [1, 0, 2]], own, atol=1e-12)


def altered(folder, change):
    document = json.loads((folder / "bundle.json").read_text("utf-8"))
    change(document["calibration"]["dynamics"])
    del document["sha256"]
    text = to_json({"schema": document["schema"], "sha256": seal(document), **document})
    (folder / "bundle.json").write_text(text, encoding="utf-8")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda part: part.update(kind="magic"),
            "unknown kind of dynamics 'magic'. Known kinds: none, output-error, transfer, subspace",
        ),
        (
            lambda part: part.pop("A"),
            "the stored dynamics cannot be read: 'A'. The bundle was altered; train it again",
        ),
        (
            lambda part: part.update(B=[[1.0]]),
            (
                "state space of order 4: expected {'A': (4, 4), 'B': (4, 1), 'C': (3, 4), "
                "'D': (3, 1)}, found {'B': (1, 1), 'D': (3, 3)}"
            ),
        ),
    ],
)
def test_dynamics_that_cannot_be_read_are_refused(tmp_path, change, message):
    save_bundle(tmp_path / "run", Bundle(IdentifiedCalibration(steady(), state_space(), DT)))
    altered(tmp_path / "run", change)
    with pytest.raises(ModelError) as error:
        load_bundle(tmp_path / "run")
    assert str(error.value) == f"{tmp_path / 'run' / 'bundle.json'}: {message}"


def test_a_static_law_is_a_steady_state_within_the_box_of_its_rows(tmp_path):
    law = mattingly(50.0)
    names = (*law.inputs, "dT_C")
    low = {"TRA_deg": 20.0, "ALT_ft": 0.0, "Mach": 0.1, "dT_C": -5.0}
    high = {"TRA_deg": 80.0, "ALT_ft": 30e3, "Mach": 0.7, "dT_C": 5.0}
    box = Envelope(*(np.array([side[name] for name in names]) for side in (low, high)))
    model = StaticLaws(names, [(law, law.starts)], box)
    inputs = RNG.uniform(box.low, box.high, (20, len(names)))
    columns = dict(zip(names, inputs.T, strict=True))
    np.testing.assert_array_equal(model.outputs(inputs)[:, 0], law.predict(law.starts, columns))
    beyond = box.high + 10.0
    assert model.outputs(beyond) == model.outputs(box.high)
    assert not model.inside(beyond)
    save_bundle(tmp_path / "run", Bundle(IdentifiedCalibration(model, NoDynamics(), DT)))
    loaded = load_bundle(tmp_path / "run").calibration
    np.testing.assert_array_equal(loaded.simulate(inputs), model.outputs(inputs))
