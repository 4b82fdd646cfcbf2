"""Names of channels, and who means which."""

import pytest

from narxcal.channels import channel
from narxcal.support.errors import ConfigError


@pytest.mark.parametrize(
    ("written", "meant"),
    [
        ("ITT_C", "EGT_C"),
        ("TGT", "EGT_C"),
        ("fuel_flow", "FF_kgph"),
        ("PLA_deg", "TRA_deg"),
        ("NH", "N2_pct"),
        ("OAT", "SAT_C"),
        ("dISA", "dT_C"),
        ("N1_pc", "N1_pct"),
    ],
)
def test_a_channel_of_another_house_is_told_our_name(written, meant):
    with pytest.raises(ConfigError) as error:
        channel(written)
    assert str(error.value) == f"unknown channel '{written}'. Did you mean '{meant}'?"
