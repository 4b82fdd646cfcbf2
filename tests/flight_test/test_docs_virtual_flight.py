"""docs/virtual_flight.md names every key, effect and parameter, with the ranges of the code."""

import re
from pathlib import Path

import pytest

from narxcal.flight_test.plan import FlightPlan
from narxcal.flight_test.scenario import PARAMETERS, FlightScenario, FlownEffect
from narxcal.flight_test.sensors import PRESETS, ChannelSensor, SensorConfig

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "docs" / "virtual_flight.md").read_text("utf-8")
KEYS = [
    (section.__name__, field.alias or name)
    for section in (FlightScenario, FlightPlan, SensorConfig, ChannelSensor)
    for name, field in section.model_fields.items()
]


@pytest.mark.parametrize(("section", "key"), KEYS)
def test_every_key_is_described(section, key):
    assert f"`{key}`" in TEXT or (key == "schema" and "`schema = " in TEXT), section


@pytest.mark.parametrize("key", FlownEffect.model_fields)
def test_every_key_of_an_effect_is_in_the_example(key):
    assert re.search(rf"^    {key} = ", TEXT, re.MULTILINE)


@pytest.mark.parametrize("effect", sorted(PARAMETERS))
def test_every_effect_stands_there_with_its_parameters_and_ranges(effect):
    row = re.search(rf"^\| `{effect}` \|(.*)\|(.*)\|.*\|$", TEXT, re.MULTILINE)
    assert row, effect
    assert re.findall(r"`(\w+)`", row[1]) == list(PARAMETERS[effect])
    said = [float(number) for number in re.findall(r"-?\d+(?:\.\d+)?", row[2])]
    sizes = list(PARAMETERS[effect].values())
    same = len({size[1:] for size in sizes}) == 1
    wanted = [value for size in (sizes[:1] if same else sizes) for value in size[1:]]
    assert said == pytest.approx(wanted)


def test_presets_and_shipped_scenarios_are_named():
    for name in (*PRESETS, *(f.stem[4:] for f in (ROOT / "configs").glob("fly_*.toml"))):
        assert f'"{name}"' in TEXT or f"`{name}`" in TEXT
