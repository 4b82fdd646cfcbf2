"""The house rules that no linter checks: sizes of functions and files, and who may import whom."""

import ast
import io
import shutil
import subprocess
import sys
import tokenize
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("narxcal", "data_prep", "training", "eval")
MODULES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
# Commands (an option each) and compiled kernels (arrays only) say with it why they take more.
EXCUSED = "noqa: PLR0913"
NO_CODE = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENCODING,
    tokenize.ENDMARKER,
}
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)


@cache
def code_lines(text):
    """Numbers of the lines that hold code: no blanks, no comments, no docstrings."""
    lines = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in NO_CODE:
            lines.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, (*FUNCTIONS, ast.ClassDef, ast.Module)):
            first = node.body[0] if node.body else None
            if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
                lines.difference_update(range(first.lineno, first.end_lineno + 1))
    return lines


@cache
def functions(text):
    """Name, size in code lines and number of parameters (but `self`) of every function."""
    return tuple(measured(text))


def measured(text):
    lines, source = code_lines(text), text.splitlines()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, FUNCTIONS):
            size = sum(node.lineno <= line <= node.end_lineno for line in lines)
            given = node.args
            names = [arg.arg for arg in (*given.posonlyargs, *given.args, *given.kwonlyargs)]
            excused = any(EXCUSED in source[n] for n in range(node.lineno - 1, node.body[0].lineno))
            count = 0 if excused else len([name for name in names if name not in ("self", "cls")])
            yield node.name, size, count


def here(path):
    return str(path.relative_to(ROOT))


def test_the_ruler_measures_what_it_should():
    text = (
        '"""Doc."""\n\n# why\ndef f(self, a, *, b):\n    """Doc\n    more."""\n'
        '    x = """two\nlines"""\n\n    return x\n'
    )
    assert functions(text) == (("f", 4, 2),)
    assert len(code_lines(text)) == 4


def test_no_file_has_two_nouns_in_it():
    sizes = {here(path): len(code_lines(path.read_text("utf-8"))) for path in MODULES}
    assert {path: size for path, size in sizes.items() if size > 300} == {}


def test_no_function_is_long():
    found = [
        (size, f"{here(path)}: {name}")
        for path in MODULES
        for name, size, _ in functions(path.read_text("utf-8"))
    ]
    assert [entry for entry in found if entry[0] > 50] == []
    sizes = sorted(size for size, _ in found)
    assert sizes[len(sizes) // 2] <= 8
    assert sizes[int(0.9 * len(sizes))] <= 25


def test_no_function_takes_more_than_five_parameters():
    found = [
        f"{here(path)}: {name} takes {count}"
        for path in MODULES
        for name, _, count in functions(path.read_text("utf-8"))
        if count > 5
    ]
    assert found == []


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
        ("narxcal/cli.py", "import eval.b, training.b, data_prep.b, narxcal.b", None),
        ("data_prep/a.py", "import narxcal.channels, narxcal.errors, narxcal.settings", None),
        ("narxcal/__main__.py", "import narxcal.cli", None),
    ],
)
def test_an_import_up_the_floors_is_caught(tmp_path, module, planted, contract):
    names = ("__init__", "a", "b")
    for file in [f"{package}/{name}.py" for package in PACKAGES for name in names]:
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
