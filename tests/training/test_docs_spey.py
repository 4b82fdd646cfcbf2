"""What docs/spey.md shows works as shown."""

import re
from pathlib import Path

import numpy as np
import pytest

PAGE = Path(__file__).parents[2] / "docs" / "spey.md"
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


@pytest.mark.slow
def test_the_blocks_run_in_order_and_give_what_the_page_says():
    names = {"__name__": "page"}
    for block in BLOCKS:
        exec(compile(block, str(PAGE), "exec", dont_inherit=True), names)  # noqa: S102
    np.testing.assert_allclose(names["N_H"], 1 - np.exp(-names["time"] / 0.6544), atol=1e-4)
    assert names["W_F"][0] / names["W_F"][-1] == pytest.approx(0.35, abs=0.01)
    assert names["left"].control.status == "converged"
    assert abs(names["tau"] - 0.654) < 4 * names["sd"]
    assert names["low"] < 0.8 < names["high"]
