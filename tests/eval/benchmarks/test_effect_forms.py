"""The table of what the library's forms explain on a physical engine is measured, not told."""

import pytest

from eval.benchmarks import effect_forms


@pytest.mark.slow
def test_a_delay_of_the_physical_engine_is_the_delay_of_the_library(monkeypatch):
    monkeypatch.setattr(effect_forms, "_FLIGHTS", 1)
    (found,) = effect_forms.explained("business_jet", ("throttle_delay",))
    assert found.truth == 0.3
    assert abs(found.found - 0.3) < 0.03
    assert 0.9 < found.share <= 1.0


def test_the_table_has_a_row_per_effect(monkeypatch, capsys):
    row = effect_forms.Explained("heat_soak", 3.0, 0.7, 70.0)
    monkeypatch.setattr(effect_forms, "explained", lambda _engine: [row])
    assert effect_forms.main() == 0
    assert capsys.readouterr().out.endswith("| `heat_soak` 3 | 0.70 |  | 0.70 |  |\n")
