"""The demonstration."""

import json

import pytest

from narxcal.cli.app import main

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def demonstration(tmp_path_factory):
    out = tmp_path_factory.mktemp("demo") / "run"
    assert main(["demo", "--out", str(out), "--quiet"]) == 0
    return out


def test_the_demonstration_needs_no_files_and_ends_with_a_page(demonstration):
    assert json.loads((demonstration / "demo.json").read_text("utf-8"))["complete"] is True
    assert (demonstration / "evaluate" / "evaluate.html").is_file()
