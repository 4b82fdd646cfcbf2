"""The wheel is all that a user needs: away from the checkout it has its packages and configs."""

import os
import subprocess
import sys
import tomllib
import zipfile
from itertools import chain
from pathlib import Path

import pytest

import narxcal
from training.config import load_config

ROOT = Path(__file__).parents[1]
PACKAGES = ("narxcal", "data_prep", "training", "eval")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    pip("wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", folder, ROOT)
    return next(folder.glob("narxcal-*.whl"))


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    folder = tmp_path_factory.mktemp("installed")
    pip("install", "--no-deps", "--no-index", "--target", folder, wheel)
    return folder


def pip(*arguments):
    command = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def away(installed, *arguments):
    """Run Python elsewhere, seeing the installed copy and not the checkout."""
    environment = {**os.environ, "PYTHONPATH": str(installed), "NUMBA_CACHE_DIR": str(installed)}
    done = subprocess.run(
        [sys.executable, *arguments],
        cwd=installed,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_wheel_holds_every_module_and_data_file(wheel):
    shipped = set(zipfile.ZipFile(wheel).namelist())
    wanted = {
        str(path.relative_to(ROOT))
        for package in (*PACKAGES, "configs")
        for path in (ROOT / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert wanted <= shipped
    assert {f"{package}/py.typed" for package in PACKAGES} <= shipped
    assert any(name.endswith("licenses/LICENSE") for name in shipped)


def test_the_wheel_holds_no_tests_and_no_logs(wheel):
    tops = {name.split("/")[0] for name in zipfile.ZipFile(wheel).namelist()}
    assert tops == {*PACKAGES, "configs", f"narxcal-{version()}.dist-info"}


def test_the_command_works_away_from_the_checkout(installed):
    assert str(installed) in away(installed, "-c", "import narxcal; print(narxcal.__file__)")
    commands = away(installed, "-m", "narxcal", "--help")
    for name in ("demo", "prepare", "train", "evaluate", "crossval", "replay", "simulate", "info"):
        assert name in commands


@pytest.mark.parametrize("name", ["agtf30.toml", "citation2.toml", "demo.toml", "jetcat.toml"])
def test_a_shipped_config_is_found_by_its_name_and_valid(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    _, folder = load_config(name)
    assert folder == ROOT / "configs"


def test_public_names_are_there_and_an_unknown_one_is_refused():
    assert all(getattr(narxcal, name) is not None for name in narxcal.__all__)
    assert set(narxcal.__all__) <= set(dir(narxcal))
    with pytest.raises(AttributeError, match=r"^module 'narxcal' has no attribute 'Narxs'$"):
        narxcal.Narxs  # noqa: B018 looked up, not used


def test_everything_tested_is_pinned():
    """Each requirement of pyproject.toml has one exact version in constraints.txt."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    wanted = [
        *project["project"]["dependencies"],
        *chain.from_iterable(project["dependency-groups"].values()),
        *chain.from_iterable(project["project"]["optional-dependencies"].values()),
    ]
    lines = (ROOT / "constraints.txt").read_text("utf-8").splitlines()
    pins = [line for line in lines if line and not line.startswith("#")]
    assert all(pin.count("==") == 1 for pin in pins)
    pinned = {plain(pin.split("==")[0]) for pin in pins}
    assert {plain(name) for name in wanted} <= pinned


def plain(requirement):
    """Normalised project name (PEP 503) of a requirement."""
    for mark in "<>=[;~! ":
        requirement = requirement.split(mark)[0]
    return requirement.lower().replace("_", "-").replace(".", "-")


def version():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    return project["project"]["version"]
