"""The C of a model computes what `simulate` does, and is C that any compiler takes."""

import ctypes
import re
import subprocess
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from narxcal.atmosphere import isa
from narxcal.calibration.identified import IdentifiedCalibration, NoDynamics
from narxcal.export.compiler import Compiled, compiler
from narxcal.export.program import Exportable, Program
from narxcal.static_models import polynomial
from narxcal.static_models.model import StaticLaws
from narxcal.steady.model import Envelope
from narxcal.support.errors import ModelError
from tests.export import models
from training.steady.static_fit import fit

if compiler() is None:
    pytest.skip("needs a C compiler", allow_module_level=True)

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic")
HOST = """
#include <stdio.h>
#include "engine.h"

int main(void)
{
    static narxcal_state state;
    narxcal_outputs out;
    double in[NARXCAL_INPUTS];
    for (int k = 0; ; k++) {
        for (int i = 0; i < NARXCAL_INPUTS; i++) if (scanf("%lf", &in[i]) != 1) return 0;
        if (k == 0) narxcal_init(&state, in), out = state.now;
        else narxcal_step(&state, in, &out);
        for (int o = 0; o < NARXCAL_OUTPUTS; o++) printf("%.17g ", out.value[o]);
        printf("\\n");
    }
}
"""


@pytest.fixture(scope="module", params=models.KINDS)
def model(request):
    return models.KINDS[request.param]()


@pytest.fixture(scope="module")
def program(model):
    return Program(model, ["drawn at random"], "00ff")


@pytest.fixture(scope="module")
def compiled(program):
    return Compiled.of(program)


def same(found, expected):
    np.testing.assert_allclose(found[..., :3], expected, rtol=0.0, atol=1e-9)


def test_a_free_run_is_that_of_simulate(model, compiled):
    inputs = models.log()
    found = compiled.run(inputs)
    same(found, model.simulate(inputs))
    assert np.ptp(found[:, :3], axis=0).min() > 5.0
    within = model.steady.inside(model.delayed_inputs(inputs))
    np.testing.assert_array_equal(found[:, -2], within)
    assert 0.2 < within.mean() < 0.9
    assert (found[:, -1] == 0.0).all()
    if model.interval is None:
        assert np.isnan(found[:, 3:6]).all()
    else:
        half = model.half_width(inputs, found[:, :3], 0.9)
        np.testing.assert_allclose(found[:, 3:6], half, rtol=1e-9)


def test_a_run_begins_at_measured_outputs_and_again_in_mid_flight(model, compiled):
    inputs = models.log()
    measured = model.steady.outputs(inputs[0]) + np.array([2.0, np.nan, 20.0])
    same(compiled.run(inputs, measured), model.simulate(inputs, measured))
    nothing = compiled.run(inputs)
    for impossible in (1e308, -1e308, np.inf, 2e4):
        np.testing.assert_array_equal(compiled.run(inputs, np.full(3, impossible)), nothing)
        same(nothing, model.simulate(inputs, np.full(3, impossible)))
    restarted = compiled.run(inputs[200:])
    same(restarted, model.simulate(inputs[200:]))


def test_a_stored_state_goes_on_as_if_nothing_had_been(compiled):
    inputs = models.log()
    whole = compiled.run(inputs)
    compiled.run(inputs[:100])
    stored = bytes(compiled.state)
    compiled.run(inputs[300:400])
    ctypes.memmove(ctypes.byref(compiled.state), stored, len(stored))
    later = compiled.steps(inputs[100:])
    np.testing.assert_array_equal(later, whole[100:])


def test_inputs_that_are_no_numbers_are_held_and_flagged(model, compiled):
    inputs = models.log(far=False)
    holed = inputs.copy()
    holed[50:60, 0], holed[100, 1], holed[200, 2] = np.nan, np.inf, -np.inf
    held = inputs.copy()
    held[50:60, 0], held[100, 1], held[200, 2] = inputs[49, 0], inputs[99, 1], inputs[199, 2]
    found = compiled.run(holed)
    same(found, model.simulate(held))
    assert np.flatnonzero(found[:, -1]).tolist() == [*range(50, 60), 100, 200]
    assert compiled.start(np.full(4, np.nan))[-1] == 1.0
    assert np.isfinite(compiled.start(np.full(4, np.nan))[:3]).all()


def test_each_engine_of_a_fitted_model_is_in_the_file(model, program, compiled):
    inputs = models.log(90)
    for number, name in enumerate(program.engines):
        same(compiled.run(inputs, engine=number), model.for_engine(name).simulate(inputs))
    expected = ("", "left", "right") if hasattr(model.steady, "engines") else ("",)
    assert program.engines == expected


@pytest.mark.slow
def test_the_code_builds_without_a_warning_and_runs_clean(model, program, tmp_path):
    for name, text in {**program.code, "host.c": HOST}.items():
        (tmp_path / name).write_text(text, "utf-8")
    checks = ("-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
    command = ["cc", *STRICT, *checks, "engine.c", "host.c", "-o", "host", "-lm"]
    built = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (built.returncode, built.stderr) == (0, "")
    inputs = models.log(240)
    done = subprocess.run(
        [tmp_path / "host"],
        input="\n".join(" ".join(map(repr, row)) for row in inputs.tolist()),
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    found = np.array([line.split() for line in done.stdout.splitlines()], dtype=float)
    same(found, model.simulate(inputs))


def test_the_code_takes_no_memory_and_calls_the_maths_library_alone(program):
    source = program.code["engine.c"]
    assert set(re.findall(r"#include (\S+)", source)) == {"<math.h>", "<stddef.h>", '"engine.h"'}
    assert not re.search(r"\b(malloc|calloc|realloc|free)\(", source)


def test_the_header_names_channels_units_envelope_and_run(program):
    header = program.code["engine.h"]
    assert "drawn at random" in header
    assert '#define NARXCAL_RUN_SHA256 "00ff"' in header
    assert "#define NARXCAL_DT_S 0.1 " in header
    assert re.search(r"    NARXCAL_FF_kgph, /\* .*fuel.* \[kg/h\] \*/", header)
    assert re.search(r"    NARXCAL_OUT_EGT_C, /\* .* \[degC\] \*/", header)
    assert "#define NARXCAL_LOW_FF_kgph (100.0)" in header


def test_what_cannot_be_exported_is_named():
    steady = models.table()
    scattered = type(steady)(
        (models.INPUTS, models.OUTPUTS),
        steady.points[:-3],
        steady.values[:-3],  # noqa: PD011
    )
    with pytest.raises(ModelError) as refused:
        Program(models.identified(models.state_space(), scattered)).code  # noqa: B018
    assert str(refused.value) == (
        "a steady state of kind 'table' is no grid. Sample it first: narxcal export does so"
    )
    dynamics = models.output_error()
    dynamics.values["square_M"] = 0.1  # noqa: PD011
    with pytest.raises(ModelError) as refused:
        Program(models.identified(dynamics)).code  # noqa: B018
    assert str(refused.value) == (
        "output error with square_M (it looks ahead) cannot be exported. "
        "Identify it without, or by another method"
    )


def test_outputs_that_output_error_does_not_have_are_steady():
    deck = models.table()
    settled = deck.outputs(deck.points)
    names = ("FN_kN", *models.OUTPUTS)
    more = type(deck)(
        (models.INPUTS, names), deck.points, np.column_stack([0.1 * settled[:, 0], settled])
    )
    dynamics = replace(models.output_error(), order=(2, 1, 3))
    model, inputs = models.identified(dynamics, more), models.log(240)
    found = Compiled.of(Program(model)).run(inputs)[:, :4]
    np.testing.assert_allclose(found, model.simulate(inputs), rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(found[:, 0], more.outputs(inputs)[:, 0], rtol=0.0, atol=1e-9)


def test_a_static_law_is_sampled_first_and_its_error_is_stated():
    lever = np.linspace(0.0, 80.0, 60)
    columns = {"TRA_deg": lever, "N1_pct": 20.0 + 0.3 * lever + 0.006 * lever**2}
    law = polynomial(columns=columns, output="N1_pct", degrees={"TRA_deg": 2})
    box = Envelope(np.array([0.0]), np.array([80.0]))
    laws = StaticLaws(("TRA_deg",), [(law, fit(law, columns).values)], box)  # noqa: PD011
    model = IdentifiedCalibration(laws, NoDynamics(), 0.1)
    exported = Exportable.of(SimpleNamespace(calibration=model, sha256="00ff"))
    inputs = np.linspace(-10.0, 90.0, 101)[:, None]
    found = Compiled.of(exported.program()).run(inputs)[:, :1]
    np.testing.assert_allclose(found, exported.model.simulate(inputs), rtol=0.0, atol=1e-9)
    stated = exported.sampled.measured.outputs[0].max
    assert 0.0 < np.abs(found - model.simulate(inputs)).max() < 1.2 * stated
    assert f"N1_pct {stated:.3g} %" in exported.about[2]


FLIGHTS = sorted(Path("../shared/data").glob("*/**/citation_*.csv.gz"))


@pytest.mark.slow
@pytest.mark.skipif(not FLIGHTS, reason="needs the flights in ../shared/data")
def test_over_a_whole_flight_it_is_simulate(model, compiled):
    log = pd.read_csv(FLIGHTS[0]).ffill().bfill()
    static = log["Dadc1_sat"] + 273.15 - isa(log["Dadc1_alt"])[0]
    fuel = 0.45359237 * log["lh_engine_FMF"]
    inputs = np.column_stack([fuel, log["Dadc1_alt"], log["Dadc1_mach"], static])
    same(compiled.run(inputs), model.simulate(inputs))
