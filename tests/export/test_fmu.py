"""An exported FMU is a real one: valid, compiled, and the same function as its Python twin."""

import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from narxcal.export import ExportOptions, Grid, export_fmu, export_table
from narxcal.export.plan import plan
from narxcal.steady.fmu import SteadyFmu
from narxcal.steady.model import Envelope
from narxcal.steady.table import read_steady_table
from narxcal.support.errors import ConfigError, ModelError

fmpy = pytest.importorskip("fmpy", reason="needs the extra fmu", exc_type=ImportError)
if shutil.which("cc") is None or not sys.platform.startswith("linux"):
    pytest.skip("needs a C compiler, on Linux", allow_module_level=True)

OUTPUTS = ("N1_pct", "N2_pct", "EGT_C")
OPTIONS = ExportOptions(tolerance_pct=1.0, probes=1000, source="<the> deck")
VERSIONS = ("2.0", "3.0")


@pytest.fixture(scope="module")
def grid(maker):
    return Grid.of_model(maker, {"WAI": [1.0]})


@pytest.fixture(scope="module")
def planned(maker, grid):
    return plan(maker, grid, OPTIONS, separate=True)


@pytest.fixture(scope="module")
def exported(maker, grid, tmp_path_factory):
    folder = tmp_path_factory.mktemp("fmu")
    return {
        version: export_fmu(maker, grid, folder / f"deck {version}.fmu", version, OPTIONS)
        for version in VERSIONS
    }


def opened(report, *more):
    return SteadyFmu(report.file, (tuple(report.axes), (*OUTPUTS, *more)))


def conditions(grid, count=400):
    """Random conditions, a third of them outside, switches between their positions too."""
    rng = np.random.default_rng(5)
    drawn = grid.draw(count, rng)[:, :-1]
    drawn[::3] += rng.normal(size=drawn[::3].shape) * np.ptp(drawn, axis=0)
    return drawn


@pytest.mark.parametrize("version", VERSIONS)
def test_the_fmu_is_valid_and_bears_names_units_and_its_error(exported, version):
    from fmpy.validation import validate_fmu  # noqa: PLC0415

    file = exported[version].file
    assert validate_fmu(file) == []
    described = fmpy.read_model_description(file)
    assert described.fmiVersion == version
    assert described.generationTool.startswith("narxcal")
    assert described.coSimulation.modelIdentifier.isidentifier()
    assert "Steady-state engine model <the> deck" in described.description
    assert "Holds for WAI = 1 only" in described.description
    assert all(name in described.description for name in OUTPUTS)
    found = {one.name: one for one in described.modelVariables}
    assert found["ALT_ft"].unit == "ft"
    assert found["ALT_ft"].description == "pressure altitude, from 0 to 43000"
    text = zipfile.ZipFile(file).read("modelDescription.xml").decode("utf-8")
    assert text.count('relativeQuantity="true"') == 1
    assert found["EGT_C"].unit == "degC"
    assert {name: float(found[name].start) for name in found if found[name].start is not None} == (
        dict.fromkeys(exported[version].axes, 0.0)
    )


@pytest.mark.parametrize("version", VERSIONS)
def test_the_compiled_code_is_its_python_twin(exported, planned, grid, version):
    fmu, inputs = opened(exported[version], "inside"), conditions(grid)
    found = fmu.outputs(inputs)
    expected = planned.gridded.outputs(inputs)
    np.testing.assert_allclose(found[:, :-1], expected, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(found[:, -1], planned.gridded.inside(inputs))
    assert 0.3 < found[:, -1].mean() < 0.9


@pytest.mark.parametrize("version", VERSIONS)
def test_the_fmu_is_the_model_within_the_error_it_states(exported, maker, grid, version):
    report = exported[version]
    assert report.met
    assert report.additive
    drawn = grid.draw(300, np.random.default_rng(77))
    off = np.abs(opened(report).outputs(drawn[:, :-1]) - maker.outputs(drawn)).max(axis=0)
    assert (off < [1.3 * one.max for one in report.measured.outputs]).all()


@pytest.mark.parametrize("version", VERSIONS)
def test_a_simulation_follows_its_inputs(exported, planned, version):
    start = dict.fromkeys(exported[version].axes, 0.0) | {"ALT_ft": 8000.0, "Mach": 0.3}
    lever = np.array([(0.0, 5.0), (10.0, 80.0)], dtype=[("time", float), ("TRA_deg", float)])
    found = fmpy.simulate_fmu(
        exported[version].file, stop_time=10.0, output_interval=1.0, start_values=start,
        input=lever, output=["N1_pct", "inside"],
    )  # fmt: skip
    inputs = np.tile(list(start.values()), (11, 1))
    inputs[:, 0] = np.linspace(5.0, 80.0, 11)
    assert found["N1_pct"][-1] > found["N1_pct"][0] + 20
    assert (found["inside"] == 1).all()
    settled = planned.gridded.outputs(inputs)[:, 0]
    # A master holds the inputs of a step from its start or takes them at its end.
    assert (np.abs(found["N1_pct"] - settled) <= np.diff(settled).max() + 1e-9).all()


def test_the_same_model_gives_the_same_bytes(maker, grid, exported, tmp_path):
    again = export_fmu(maker, grid, tmp_path / "deck 2.0.fmu", "2.0", OPTIONS)
    assert Path(again.file).read_bytes() == Path(exported["2.0"].file).read_bytes()
    assert again.bytes == Path(again.file).stat().st_size
    names = set(zipfile.ZipFile(again.file).namelist())
    assert {f"sources/{name}" for name in
            ("fmi2.c", "fmi.c", "fmi.h", "engine.c", "engine.h", "token.h")} < names  # fmt: skip


def plane(inputs):
    lever, mach = inputs.T
    return np.column_stack([20 + 0.9 * lever * (1 - mach), 300 + 4 * lever])


class Corner:
    """A plane that holds only where lever and Mach are not both high."""

    input_names, output_names = ("TRA_deg", "Mach"), ("N1_pct", "EGT_C")
    envelope = Envelope(np.zeros(2), np.array([80.0, 0.8]))

    def outputs(self, inputs):
        inputs = np.asarray(inputs)
        return plane(inputs.reshape(-1, 2)).reshape(*inputs.shape[:-1], 2)

    def inside(self, inputs):
        lever, mach = np.moveaxis(np.asarray(inputs), -1, 0)
        held = (lever >= 0) & (lever <= 80) & (mach >= 0) & (mach <= 0.8)
        return held & ~((lever > 50) & (mach > 0.5))


@pytest.fixture(scope="module")
def corner(tmp_path_factory):
    file = tmp_path_factory.mktemp("corner") / "3 corner.fmu"
    nodes = {"TRA_deg": [0.0, 25.0, 50.0, 80.0], "Mach": [0.0, 0.5, 0.8]}
    return export_fmu(Corner(), Grid.of_model(Corner(), nodes), file)


def test_inside_is_that_of_the_model_not_of_its_box(corner):
    fmu = SteadyFmu(corner.file, (Corner.input_names, ("N1_pct", "EGT_C", "inside")))
    at = np.array([[40.0, 0.7], [70.0, 0.4], [50.0, 0.8], [51.0, 0.6], [80.0, 0.8], [81.0, 0.1]])
    found = fmu.outputs(at)
    assert found[:, 2].tolist() == [1, 1, 1, 0, 0, 0]
    np.testing.assert_allclose(found[:5, :2], plane(at[:5]), rtol=1e-9)
    np.testing.assert_allclose(found[5, :2], plane(np.array([[80.0, 0.1]]))[0], rtol=1e-9)


def test_nodes_given_make_the_fmu_the_table_itself(corner, tmp_path):
    nodes = {"TRA_deg": [0.0, 25.0, 50.0, 80.0], "Mach": [0.0, 0.5, 0.8]}
    export_table(Corner(), Grid.of_model(Corner(), nodes), tmp_path / "corner.csv")
    table = read_steady_table(tmp_path / "corner.csv")
    inputs = np.random.default_rng(0).uniform([-10, -0.1], [90, 0.9], (200, 2))
    fmu = SteadyFmu(corner.file, (Corner.input_names, Corner.output_names))
    np.testing.assert_allclose(fmu.outputs(inputs), table.outputs(inputs), rtol=1e-12)


class Raw:
    """The FMU's own functions, without narxcal's checks."""

    def __init__(self, file, version):
        folder = fmpy.extract(file)
        self.described = fmpy.read_model_description(file)
        self.references = {one.name: one.valueReference for one in self.described.modelVariables}
        self.slave = fmpy.instantiate_fmu(folder, self.described, "CoSimulation")
        self.fmi3 = version == "3.0"
        if not self.fmi3:
            self.slave.setupExperiment(startTime=0.0)
        self.slave.enterInitializationMode()
        self.slave.exitInitializationMode()

    def set(self, references, values):
        (self.slave.setFloat64 if self.fmi3 else self.slave.setReal)(references, values)

    def get(self, references):
        return list((self.slave.getFloat64 if self.fmi3 else self.slave.getReal)(references))


@pytest.mark.parametrize("version", VERSIONS)
def test_reset_gives_the_start_back_and_what_is_no_number_is_held(version, tmp_path):
    grid = Grid.of_model(Corner(), {"TRA_deg": [20.0, 80.0]})
    report = export_fmu(Corner(), grid, tmp_path / "deck.fmu", version)
    raw = Raw(report.file, version)
    inside, held = (raw.references[name] for name in ("inside", "held"))
    assert raw.get([0, 1, 3, inside, held]) == [20.0, 0.0, 380.0, 1.0, 0.0]
    raw.set([0, 1], [40.0, 0.2])
    assert raw.get([3]) == [pytest.approx(460.0)]
    raw.slave.doStep(0.0, 0.5)
    assert raw.get([3]) == [pytest.approx(460.0)]
    for unknown in ("nan", "inf"):
        raw.set([0], [float(unknown)])
        assert raw.get([3, held]) == [pytest.approx(460.0), 1.0]
    raw.slave.reset()
    assert raw.get([0, 3, held]) == [20.0, 380.0, 0.0]
    for references in ([2], [99]):
        with pytest.raises(Exception, match="failed with status 3"):
            raw.set(references, [1.0])
    with pytest.raises(Exception, match="failed with status 3"):
        raw.get([99])
    if version == "3.0":
        raw.slave.doStep(1.0, 0.5)
        assert raw.get([raw.references["time"]]) == [1.5]
    raw.slave.terminate()
    raw.slave.freeInstance()


@pytest.mark.parametrize("version", VERSIONS)
def test_an_fmu_whose_description_was_swapped_does_not_start(corner, version, tmp_path):
    report = export_fmu(Corner(), Grid.of_model(Corner()), tmp_path / "deck.fmu", version)
    swapped = tmp_path / "swapped.fmu"
    with zipfile.ZipFile(report.file) as source, zipfile.ZipFile(swapped, "w") as target:
        for name in source.namelist():
            data = source.read(name)
            if name == "modelDescription.xml":
                data = re.sub(rb"\{[0-9a-f-]+\}", b"{0}", data)
            target.writestr(name, data)
    with pytest.raises(ModelError, match="the FMU does not start"):
        SteadyFmu(swapped, (Corner.input_names, Corner.output_names))


@pytest.mark.parametrize("version", VERSIONS)
def test_the_sources_build_without_a_warning(exported, version, tmp_path):
    with zipfile.ZipFile(exported[version].file) as archive:
        archive.extractall(tmp_path)
    flags = ["-std=c99", "-Wall", "-Wextra", "-pedantic", "-Wno-unused-parameter", "-Werror"]
    headers = Path(fmpy.__path__[0]) / "c-code"
    sources = sorted((tmp_path / "sources").glob("*.c"))
    subprocess.run(
        ["cc", "-fsyntax-only", *flags, f"-I{headers}", *sources], check=True, capture_output=True
    )


@pytest.mark.parametrize("version", VERSIONS)
def test_fmpy_builds_the_binary_from_the_sources_alone(version, tmp_path):
    if shutil.which("cmake") is None or shutil.which("make") is None:
        pytest.skip("needs cmake and make")
    report = export_fmu(Corner(), Grid.of_model(Corner()), tmp_path / "deck.fmu", version)
    built = tmp_path / "built.fmu"
    with zipfile.ZipFile(report.file) as source, zipfile.ZipFile(built, "w") as target:
        for name in source.namelist():
            if not name.startswith("binaries/"):
                target.writestr(name, source.read(name))
    command = [sys.executable, "-m", "fmpy", "compile", built]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    names = (Corner.input_names, Corner.output_names)
    inputs = np.random.default_rng(0).uniform([0, 0], [80, 0.8], (50, 2))
    np.testing.assert_array_equal(
        SteadyFmu(built, names).outputs(inputs), SteadyFmu(report.file, names).outputs(inputs)
    )


def refused(error, message, file, fmi="2.0"):
    with pytest.raises(error, match=f"^{re.escape(message)}$"):
        export_fmu(Corner(), Grid.of_model(Corner()), file, fmi)
    assert not file.exists()


def test_another_version_of_the_standard_is_refused(tmp_path):
    refused(ConfigError, "unknown FMI version '1.0'. Use 2.0 or 3.0", tmp_path / "deck.fmu", "1.0")


def test_a_missing_extra_says_how_to_install_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "fmpy", None)
    message = (
        "an FMU needs the headers that FMPy ships, and it is not installed. "
        "pip install 'narxcal[fmu]'"
    )
    refused(ModelError, message, tmp_path / "deck.fmu")


def test_a_machine_without_a_compiler_gives_the_sources_alone(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    report = export_fmu(Corner(), Grid.of_model(Corner()), tmp_path / "deck.fmu")
    names = zipfile.ZipFile(report.file).namelist()
    assert "sources/engine.c" in names
    assert not [name for name in names if name.startswith("binaries/")]


def test_missing_headers_are_named(tmp_path, monkeypatch):
    monkeypatch.setattr(fmpy, "__path__", [str(tmp_path)])
    message = (
        f"{tmp_path / 'c-code'}: FMPy {fmpy.__version__} lacks the headers of FMI 3.0. "
        "Install the version of FMPy that constraints.txt names"
    )
    refused(ModelError, message, tmp_path / "deck.fmu", "3.0")


@pytest.mark.parametrize(
    ("script", "said"), [("echo oh >&2; echo no headers >&2", "no headers"), ("", "nothing")]
)
def test_what_a_failing_compiler_says_is_passed_on(tmp_path, monkeypatch, script, said):
    compiler = tmp_path / "cc"
    compiler.write_text(f"#!/bin/sh\n{script}\nexit 7\n", "utf-8")
    compiler.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    message = (
        f"{compiler}: the C compiler failed with exit code 7: {said}. "
        "Check that it compiles C, or export a table"
    )
    refused(ModelError, message, tmp_path / "deck.fmu")
