"""The house rules that no linter checks."""

from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MODULES = [
    path
    for package in ("narxcal", "data_prep", "training", "eval")
    for path in (ROOT / package).rglob("*.py")
]


@pytest.mark.parametrize("word", ["TODO", "FIXME", "XXX", "NotImplementedError", "import pickle"])
def test_nothing_is_left_for_later(word):
    assert [path for path in MODULES if word in path.read_text("utf-8")] == []
