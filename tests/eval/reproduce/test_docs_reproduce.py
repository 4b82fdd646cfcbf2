"""What docs/reproduce.md shows works as shown."""

import re
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[3] / "docs" / "reproduce.md"
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


@pytest.mark.slow
def test_the_blocks_run_in_order_and_give_what_the_page_says():
    names = {"__name__": "page"}
    for block in BLOCKS:
        exec(compile(block, str(PAGE), "exec", dont_inherit=True), names)  # noqa: S102
    assert names["tau_low"] < 0.8 < names["tau_high"]
    assert names["result"].mean_pct < 0.2
    assert names["again"].score.mean_pct == pytest.approx(names["fuel"].score.mean_pct, rel=0.05)
