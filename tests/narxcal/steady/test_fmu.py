"""A real FMU, compiled here, as steady-state model."""

import gc
import re
import sys
import time
import zipfile
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import joblib
import numpy as np
import pytest

from narxcal.steady.fmu import SteadyFmu
from narxcal.steady.model import (
    CarriesFiles,
    SteadyOptions,
    SteadyStateModel,
)
from narxcal.steady.opening import steady_from_json, steady_to_json
from narxcal.support.errors import ConfigError, ModelError

NAMES = (("TRA_deg", "Mach"), ("N1_pct", "EGT_C"))
ITT = {"variables": {"EGT_C": "ITT"}}


def helper():
    spec = spec_from_file_location("fmu_source", Path(__file__).parents[1] / "fmu_source.py")
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


SOURCE = helper()


@pytest.fixture(scope="module")
def fmu(tmp_path_factory):
    return SOURCE.build(tmp_path_factory.mktemp("fmu") / "deck.fmu", 2)


@pytest.fixture(scope="module")
def fmu3(tmp_path_factory):
    return SOURCE.build(tmp_path_factory.mktemp("fmu3") / "deck.fmu", 3)


def model(file, **options):
    return SteadyFmu(file, NAMES, SteadyOptions(**ITT, **options))


def truth(inputs, settle_s=1.0):
    settled = 20 + 0.9 * inputs[..., 0] - 5 * inputs[..., 1]
    return np.stack([settled * (1 - np.exp(-settle_s / 0.1)), 300 + 4 * inputs[..., 0]], axis=-1)


@pytest.mark.parametrize("version", ["fmu", "fmu3"])
def test_an_fmu_gives_what_its_equations_say(version, request):
    deck = model(request.getfixturevalue(version))
    assert isinstance(deck, SteadyStateModel)
    assert isinstance(deck, CarriesFiles)
    inputs = np.random.default_rng(0).uniform([0, 0], [78, 0.9], (5, 8, 2))
    np.testing.assert_allclose(deck.outputs(inputs), truth(inputs), rtol=1e-12)


@pytest.mark.parametrize("version", ["fmu", "fmu3"])
def test_a_sample_does_not_depend_on_the_one_before(version, request):
    deck = model(request.getfixturevalue(version), settle_s=0.05)
    inputs = np.array([[78.0, 0.0], [0.0, 0.0], [78.0, 0.0]])
    found = deck.outputs(inputs)
    np.testing.assert_array_equal(found[0], found[2])
    np.testing.assert_allclose(found, truth(inputs, 0.05), rtol=1e-12)


def test_a_longer_run_settles_further(fmu):
    at = np.array([[50.0, 0.5]])
    far, near = (abs(model(fmu, settle_s=s).outputs(at)[0, 0] - 62.5) for s in (0.2, 3.0))
    assert near < 1e-9 < far


def test_nan_gives_nan_and_the_envelope_clamps_and_tells(fmu):
    deck = model(fmu, ranges={"Mach": (0.0, 0.8)})
    inputs = np.array([[10.0, 0.95], [10.0, 0.8], [np.nan, 0.5], [np.inf, 0.5]])
    found = deck.outputs(inputs)
    np.testing.assert_array_equal(found[0], found[1])
    assert np.isnan(found[2:]).all()
    assert deck.inside(inputs).tolist() == [False, True, False, False]
    assert deck.outputs(inputs[:0]).shape == (0, 2)


def test_an_error_of_the_fmu_names_the_conditions(fmu):
    message = rf"^{re.escape(str(fmu))}: the FMU failed at TRA_deg 10, Mach 0\.95: .*DoStep"
    deck = model(fmu)
    with pytest.raises(ModelError, match=message):
        deck.outputs(np.array([[10.0, 0.95]]))
    np.testing.assert_allclose(deck.outputs([[10.0, 0.5]]), truth(np.array([[10.0, 0.5]])))


def test_a_stored_fmu_comes_back_and_another_one_is_refused(fmu, tmp_path):
    file = tmp_path / "deck.fmu"
    file.write_bytes(fmu.read_bytes())
    deck = model(file, ranges={"Mach": (0.0, 0.8)})
    meta, arrays = steady_to_json(deck)
    assert meta["kind"] == "fmu"
    back = steady_from_json(meta, arrays, trust=True)
    probe = np.array([[10.0, 0.85]])
    np.testing.assert_array_equal(back.outputs(probe), deck.outputs(probe))
    assert not back.inside(probe).any()
    file.write_bytes(fmu.read_bytes() + b"\0")
    message = (
        f"{file}: the FMU is not the one the bundle was trained on. "
        "Restore the former file, or train anew"
    )
    with pytest.raises(ModelError, match=f"^{re.escape(message)}$"):
        steady_from_json(meta, arrays, trust=True)
    file.unlink()
    message = f"{file}: the FMU of this bundle is missing. Put it there again"
    with pytest.raises(ModelError, match=f"^{re.escape(message)}$"):
        steady_from_json(meta, arrays, trust=True)


def test_worker_processes_open_the_fmu_themselves(fmu):
    deck, inputs = model(fmu), np.array([[40.0, 0.3]])
    found = joblib.Parallel(n_jobs=2)(joblib.delayed(deck.outputs)(inputs) for _ in range(2))
    np.testing.assert_array_equal(found, [deck.outputs(inputs)] * 2)


def test_what_was_unpacked_is_removed_with_the_model(fmu, monkeypatch, tmp_path):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    deck = model(fmu)
    assert len(list(tmp_path.iterdir())) == 1
    del deck
    gc.collect()
    assert list(tmp_path.iterdir()) == []


def test_ten_thousand_samples_take_seconds(fmu):
    deck, inputs = model(fmu), np.random.default_rng(0).uniform(0, 0.9, (10_000, 2))
    start = time.perf_counter()
    deck.outputs(inputs)
    assert time.perf_counter() - start < 10.0


FMI1 = """\
<fmiModelDescription fmiVersion="1.0" modelName="deck" modelIdentifier="deck" guid="{deck}"
  numberOfContinuousStates="0" numberOfEventIndicators="0"><ModelVariables/></fmiModelDescription>
"""


def test_an_fmu_of_another_version_is_refused(tmp_path):
    old = tmp_path / "old.fmu"
    with zipfile.ZipFile(old, "w") as archive:
        archive.writestr("modelDescription.xml", FMI1)
    message = f"{old}: the FMU is of FMI 1.0, expected 2.0 or 3.0"
    with pytest.raises(ModelError, match=f"^{re.escape(message)}$"):
        model(old)


@pytest.mark.parametrize(
    ("names", "options", "message"),
    [
        (
            (("TRA",), ("N1_pct",)),
            {},
            "channel TRA: the FMU has no variable 'TRA'. Did you mean 'TRA_deg'?",
        ),
        (
            (("TRA_deg",), ("Q",)),
            {},
            "channel Q: the FMU has no variable 'Q'. It has TRA_deg, Mach, N1_pct, ITT, mode",
        ),
        (
            (("TRA_deg",), ("WOW",)),
            {"variables": {"WOW": "mode"}},
            "channel WOW: variable 'mode' is Integer, expected a real number",
        ),
    ],
)
def test_a_variable_that_does_not_fit_is_named(fmu, names, options, message):
    with pytest.raises(ModelError, match=f"^{re.escape(f'{fmu}, {message}')}$"):
        SteadyFmu(fmu, names, SteadyOptions(**options))


def refused(file, message):
    with pytest.raises(ModelError, match=f"^{re.escape(str(file))}: {message}$"):
        SteadyFmu(file, NAMES)


def test_a_missing_extra_says_how_to_install_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "fmpy", None)
    refused(
        tmp_path / "deck.fmu",
        r"an FMU needs FMPy, which is not installed\. pip install 'narxcal\[fmu\]'",
    )


def test_files_that_are_no_runnable_fmu_are_refused(tmp_path):
    fmpy = pytest.importorskip("fmpy", reason="needs the extra fmu", exc_type=ImportError)
    file = tmp_path / "deck.fmu"
    refused(file, "the FMU does not exist")
    file.write_bytes(b"not a zip")
    refused(file, "the file is no FMU: it is not a zip archive")
    refused(SOURCE.packed(file, "<no"), "the file is no FMU that can be read: .*")
    here = fmpy.platform
    refused(SOURCE.packed(file), f"the FMU has no binary for {here}, only none")
    refused(
        SOURCE.packed(file, members=["sources/deck.c"]),
        rf"the FMU has no binary for {here}, only c-code\. Build its sources: fmpy compile FILE",
    )
    exchange = SOURCE.XML2.replace("<CoSimulation", "<ModelExchange").replace(
        ' canHandleVariableCommunicationStepSize="true"', ""
    )
    refused(
        SOURCE.packed(file, exchange),
        r"the FMU offers no co-simulation\. Export it for co-simulation",
    )


def test_a_binary_that_does_not_load_is_refused_and_the_working_directory_kept(tmp_path):
    fmpy = pytest.importorskip("fmpy", reason="needs the extra fmu", exc_type=ImportError)
    if not sys.platform.startswith("linux"):
        pytest.skip("the name of the binary is that of Linux")
    before = Path.cwd()
    file = SOURCE.packed(tmp_path / "deck.fmu", members=[f"binaries/{fmpy.platform}/deck.so"])
    refused(file, "the FMU does not start: .*")
    assert Path.cwd() == before


def test_a_settling_time_of_zero_is_refused():
    message = "key 'settle_s': Input should be greater than 0, found 0"
    with pytest.raises(ConfigError, match=f"^{message}$"):
        SteadyOptions.parse({"settle_s": 0})
