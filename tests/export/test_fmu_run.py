"""A dynamic FMU: valid, equal to `simulate` at any step, and legal in the hands of any tool."""

import shutil
import subprocess
import sys
import zipfile
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from narxcal.export.fmu import write_fmu
from narxcal.export.fmu_run import FmuRun, compare
from narxcal.export.program import Program
from narxcal.export.proof import BOUND, Case, drawn, largest
from tests.export import models

fmpy = pytest.importorskip("fmpy", reason="needs the extra export", exc_type=ImportError)
if shutil.which("cc") is None or not sys.platform.startswith("linux"):
    pytest.skip("needs a C compiler, on Linux", allow_module_level=True)

KINDS = ("narx behind limited lags", "transfer", "no dynamics")


@pytest.fixture(scope="module", params=[("2.0", KINDS[0]), ("3.0", KINDS[0]), ("2.0", KINDS[1])])
def made(request, tmp_path_factory):
    version, kind = request.param
    program = Program(models.KINDS[kind](), ["a model drawn at random"])
    file = tmp_path_factory.mktemp("fmu") / "engine.fmu"
    write_fmu(program, file, version)
    return program, file


@pytest.fixture
def unit(made):
    program, file = made
    with FmuRun(file, program.model.input_names, program.model.output_names) as fmu:
        yield program.model, fmu


def test_the_fmu_is_valid_and_bears_channels_interval_and_parameters(made):
    from fmpy.validation import validate_fmu  # noqa: PLC0415

    _, file = made
    assert validate_fmu(str(file)) == []
    described = fmpy.read_model_description(str(file))
    found = {one.name: one for one in described.modelVariables}
    assert {*models.INPUTS, *models.OUTPUTS, "EGT_C_low", "EGT_C_high", "inside", "held"} < {*found}
    assert found["engine"].description == "which engine: 0 in general, 1 left, 2 right"
    assert found["EGT_C_high"].unit == "degC"
    assert found["interpolate"].causality == "parameter"
    assert float(described.defaultExperiment.stepSize) == models.DT_S


def test_it_is_simulate_at_every_step_with_states_set(made):
    program, file = made
    cases = [drawn(program.envelope), Case("moves", "right", models.log(300))]
    rows, step_us = compare(program, file, cases)
    assert step_us > 0.0
    assert {row["what"] for row in rows} == {
        "free run", "restart in mid-flight", "step of 0.1 s", "step of 0.02 s", "step of 0.25 s",
        "state stored and set",
    }  # fmt: skip
    assert largest(rows) < BOUND


@pytest.mark.parametrize("interpolate", [False, True])
def test_inputs_are_held_or_run_straight_within_a_long_step(unit, interpolate):
    model, fmu = unit
    ends = models.log(120, far=False)[::30]
    fmu.start(ends[0], interpolate=interpolate)
    found = fmu.run(ends[1:], 3.0)
    shares = np.arange(1, 31)[:, None] / 30.0 if interpolate else 1.0
    between = [a + (b - a) * shares * np.ones((30, 1)) for a, b in pairwise(ends)]
    expected = model.simulate(np.vstack([ends[:1], *between]))
    np.testing.assert_allclose(found, expected[30::30], atol=1e-9)


def test_inputs_that_arrive_after_initialisation_are_those_of_the_equilibrium(unit):
    model, fmu = unit
    inputs = models.log(60, far=False)
    fmu.start(None)
    found = fmu.run(inputs, 0.1)
    np.testing.assert_allclose(found, model.simulate(inputs[[0, *range(60)]])[1:], atol=1e-9)
    # Some inputs before, the lever after.
    fmu.unit.begin()
    fmu.unit.put(fmu.inputs[1:], inputs[0, 1:].tolist())
    fmu.slave.exitInitializationMode()
    first = inputs.copy()
    first[0, 0] = inputs[1, 0]
    np.testing.assert_allclose(fmu.run(inputs[1:], 0.1), model.simulate(first)[1:], atol=1e-9)


def test_between_two_samples_outputs_run_to_the_next(unit):
    model, fmu = unit
    inputs = models.log(60, far=False)
    fmu.start(inputs[0])
    lever = inputs[40]
    quarter = fmu.run(np.tile(lever, (4, 1)), 0.025)
    ahead = model.simulate(np.vstack([inputs[0], lever]))
    shares = np.array([0.25, 0.5, 0.75, 1.0])[:, None]
    np.testing.assert_allclose(quarter, ahead[0] + shares * (ahead[1] - ahead[0]), atol=1e-9)


def test_flags_say_what_was_held_and_what_is_outside(unit):
    _, fmu = unit
    flags = [fmu.references[name] for name in ("inside", "held")]
    inputs = models.log(60, far=False)
    fmu.start(inputs[0])
    fmu.run(inputs[1:2] * [np.nan, 1.0, 1.0, 1.0], 0.1)
    assert fmu.unit.get(flags) == [1.0, 1.0]
    fmu.run(inputs[2:3] + np.array([0.0, 5e4, 0.0, 0.0]), 0.1, 1)
    assert fmu.unit.get(flags) == [0.0, 0.0]
    low, high = (fmu.references[f"N1_pct_{end}"] for end in ("low", "high"))
    found = fmu.unit.get([low, fmu.references["N1_pct"], high])
    assert found[0] < found[1] < found[2]


def test_a_step_backwards_and_a_late_engine_are_refused(unit):
    _, fmu = unit
    fmu.start(models.log(60)[0])
    with pytest.raises(Exception, match="failed with status 3"):
        fmu.slave.doStep(0.0, -0.1)
    fmu.slave.doStep(0.0, 0.1)
    with pytest.raises(Exception, match="failed with status 3"):
        fmu.set_engine(1)
    with pytest.raises(Exception, match="failed with status 3"):
        fmu.unit.put([fmu.references["engine"]], [1.0])


def test_a_model_without_dynamics_follows_its_inputs_at_once(tmp_path):
    program = Program(models.KINDS["no dynamics"]())
    write_fmu(program, tmp_path / "static.fmu")
    model, inputs = program.model, models.log(60)
    with FmuRun(tmp_path / "static.fmu", model.input_names, model.output_names) as fmu:
        fmu.start(inputs[0])
        found = fmu.run(inputs[1:], 0.1)
    np.testing.assert_allclose(found, model.simulate(inputs)[1:], atol=1e-9)


def test_the_wrapper_builds_without_a_warning(made, tmp_path):
    with zipfile.ZipFile(made[1]) as archive:
        archive.extractall(tmp_path)
    flags = ["-std=c99", "-Wall", "-Wextra", "-pedantic", "-Wno-unused-parameter", "-Werror"]
    headers = Path(fmpy.__path__[0]) / "c-code"
    sources = sorted((tmp_path / "sources").glob("*.c"))
    command = ["cc", "-fsyntax-only", *flags, f"-I{headers}", *map(str, sources)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
