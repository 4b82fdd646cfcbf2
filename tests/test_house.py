"""The house rules that no linter checks: nothing left for later, and who may import whom."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("narxcal", "data_prep", "training", "eval")
MODULES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))


def here(path):
    return str(path.relative_to(ROOT))


@pytest.mark.parametrize("word", ["TODO", "FIXME", "XXX", "NotImplementedError", "import pickle"])
def test_nothing_is_left_for_later(word):
    assert [here(path) for path in MODULES if word in path.read_text("utf-8")] == []


def lint_imports(house):
    command = [Path(sys.executable).parent / "lint-imports", "--no-logo", "--no-cache"]
    return subprocess.run(command, cwd=house, capture_output=True, text=True, check=False)


def test_imports_go_down_the_floors():
    result = lint_imports(ROOT)
    assert result.returncode == 0, result.stdout + result.stderr


@pytest.mark.parametrize(
    ("module", "planted", "contract"),
    [
        ("training/a.py", "import eval.b", "An import goes down a floor, never up"),
        ("data_prep/a.py", "import training.b", "An import goes down a floor, never up"),
        ("narxcal/a.py", "import data_prep.b", "The models know no flight files"),
        ("narxcal/a.py", "import training.b", "The models know no flight files"),
        ("narxcal/a.py", "from eval import b", "The models know no flight files"),
        ("eval/a.py", "import narxcal.cli", "Nothing rests on the command line"),
        ("narxcal/a.py", "import narxcal.cli", "Nothing rests on the command line"),
        ("data_prep/a.py", "import narxcal.b", "Data preparation shares only words"),
        (
            "narxcal/turbofan/a.py",
            "import narxcal.lumped.b",
            "The virtual engine shares no equation",
        ),
        (
            "narxcal/turbofan/a.py",
            "import narxcal.effects.b",
            "The virtual engine shares no equation",
        ),
        ("narxcal/cli.py", "import eval.b, training.b, data_prep.b, narxcal.b", None),
        (
            "data_prep/a.py",
            "import narxcal.channels, narxcal.support.errors, narxcal.support.settings",
            None,
        ),
        ("narxcal/__main__.py", "import narxcal.cli", None),
    ],
)
def test_an_import_up_the_floors_is_caught(tmp_path, module, planted, contract):
    names = ("__init__", "a", "b")
    rooms = (*PACKAGES, "narxcal/turbofan", "narxcal/lumped", "narxcal/effects")
    for file in [f"{room}/{name}.py" for room in rooms for name in names]:
        (tmp_path / file).parent.mkdir(exist_ok=True)
        (tmp_path / file).touch()
    for name in ("__main__", "cli", "channels", "errors", "settings"):
        (tmp_path / "narxcal" / f"{name}.py").touch()
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    (tmp_path / module).write_text(f"{planted}\n", "utf-8")
    result = lint_imports(tmp_path)
    broken = [line for line in result.stdout.splitlines() if line.endswith("BROKEN")]
    if contract is None:
        assert result.returncode == 0, result.stdout
    else:
        assert any(line.startswith(contract) for line in broken), result.stdout


@pytest.mark.slow
def test_preparing_data_does_not_wait_for_torch():
    script = (
        "import importlib, pkgutil, sys, data_prep\n"
        "for found in pkgutil.walk_packages(data_prep.__path__, 'data_prep.'):\n"
        "    importlib.import_module(found.name)\n"
        "sys.exit('torch is imported' if 'torch' in sys.modules else None)"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
