"""What docs/steady_state.md shows works as shown."""

import re
import textwrap
from pathlib import Path

import numpy as np
import pytest

from narxcal.steady.model import SteadyOptions

PAGE = Path(__file__).parents[3] / "docs" / "steady_state.md"


@pytest.fixture
def blocks(tmp_path, monkeypatch):
    text = PAGE.read_text(encoding="utf-8")
    table = re.search(r"((?:^    .*\n)+)", text, re.MULTILINE).group(1)
    (tmp_path / "deck.csv").write_text(textwrap.dedent(table), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return re.findall(r"```python\n(.*?)```", text, re.DOTALL)


def run(code):
    names = {}
    exec(compile(code, str(PAGE), "exec"), names)  # noqa: S102
    return names["deck"]


def test_the_table(blocks):
    deck = run(
        next(code for code in blocks if "read_steady_table" in code).splitlines()[0] + "\n"
        'deck = read_steady_table("deck.csv")'
    )
    np.testing.assert_allclose(deck.outputs([78.0, 41000.0]), [98.2, 99.0, 702.0])


def test_the_function(blocks, tmp_path):
    module = next(code for code in blocks if "# maker_deck.py" in code)
    (tmp_path / "maker_deck.py").write_text(module, encoding="utf-8")
    deck = run(next(code for code in blocks if "SteadyCallable" in code))
    np.testing.assert_allclose(deck.outputs([[10.0, 0.5]]), [[26.5, 340.0]])


def test_the_options_of_the_fmu(blocks):
    code = next(code for code in blocks if "SteadyOptions(" in code)
    options = re.search(r"SteadyOptions\(.*?\}, settle_s=20\.0\)", code, re.DOTALL).group(0)
    assert eval(options, {"SteadyOptions": SteadyOptions}).settle_s == 20.0  # noqa: S307
