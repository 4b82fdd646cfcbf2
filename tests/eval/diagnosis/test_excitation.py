"""Too few pushes or pulls are refused, and the refusal says what to fly."""

import pytest

from data_prep.events import PULL, PUSH
from eval.diagnosis.flights import check_excitation, events_of
from narxcal.support.errors import DataError


def test_slams_are_found_with_their_direction(make_data):
    data = make_data(flights=2)
    events = events_of(data)
    assert len(events) == 2
    labels = [event.label for event in events[0]]
    assert labels.count(PUSH) >= 5
    assert labels.count(PULL) >= 5
    check_excitation(data, events)


def test_what_is_missing_is_said(make_data):
    data = make_data(flights=2)
    events = events_of(data)
    pushes = tuple(event for event in events[0] if event.label == PUSH)
    with pytest.raises(
        DataError,
        match=r"5 pushes and 1 pull of TRA_deg in 2 flights, 3 of each are needed\. "
        r"Fly at least 2 more pulls, idle to high power",
    ):
        check_excitation(data, (pushes[:5], [e for e in events[0] if e.label == PULL][:1]))
    with pytest.raises(DataError, match="Fly at least 3 more pushes and 3 more pulls"):
        check_excitation(data, ((), ()))
