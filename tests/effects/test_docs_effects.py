"""The page of the effects says what the code says."""

from pathlib import Path

import pytest

from narxcal.effects import LIBRARY

PAGE = (Path(__file__).parents[2] / "docs" / "effects.md").read_text("utf-8")


@pytest.mark.parametrize("kind", LIBRARY.values(), ids=LIBRARY)
def test_every_effect_has_its_row(kind):
    rows = [line.split("|") for line in PAGE.splitlines() if line.startswith(f"| `{kind.id}")]
    assert rows, f"docs/effects.md has no row on {kind.id}"
    row = [cell.strip() for cell in rows[0]]
    assert row[2:4] == [kind.side, kind.family]
    if "as `sensor_lag`" not in row[5]:
        for p in kind.fixed:
            assert f"`{p.name}`: {p.unit}, {p.low:g} to {p.high:g}" in row[5]
