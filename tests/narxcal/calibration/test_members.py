"""Simple models alone, in pieces, and as members of a mixture."""

import numpy as np
import pytest

from narxcal.calibration.members import Member, Members
from narxcal.support.errors import ModelError

RISE = np.column_stack([np.linspace(0.0, 1.0, 50) ** 2, np.linspace(1.0, 0.0, 50)])
ARX = Member("arx", 0, poles=(0.9, -0.2), gains=((0.1, 0.0), (0.2, 0.1), (0.0, 0.0)), offset=0.01)
LAG = Member("first_order", 1, push=0.2, pull=0.4)


def by_hand(member, ss, first):
    """The equations of the module, sample by sample."""
    y, found = [first] * 3, [first]
    for k in range(1, len(ss)):
        if member.kind == "first_order":
            ahead = ss[k, member.channel] - y[0]
            new = y[0] + (member.push if ahead > 0 else member.pull) * ahead
        else:
            new = member.offset + sum(a * past for a, past in zip(member.poles, y, strict=False))
            new += sum(np.dot(b, ss[max(k - i, 0)]) for i, b in enumerate(member.gains))
        y = [new, *y[:2]]
        found.append(new)
    return np.array(found)


@pytest.mark.parametrize("member", [ARX, LAG])
def test_the_compiled_run_is_that_of_the_equations(member):
    np.testing.assert_allclose(member.simulate(RISE, 0.3), by_hand(member, RISE, 0.3), rtol=1e-12)


def test_the_steady_state_has_no_memory():
    assert Member("steady_state", 1).simulate(RISE, 0.4)[1:].tolist() == RISE[1:, 1].tolist()


def test_members_give_the_same_in_any_pieces():
    model, first = Members((ARX, LAG, Member("steady_state", 1))), np.array([0.4, 0.6])
    whole = model.started(RISE[0], first).advance(RISE[1:])
    state = model.started(RISE[0], first)
    pieces = [state.advance(RISE[a:b]) for a, b in ((1, 2), (2, 17), (17, 17), (17, 50))]
    np.testing.assert_allclose(np.concatenate(pieces), whole, rtol=1e-12)


def test_one_step_from_its_own_free_run_is_that_run():
    model, first = Members((ARX, LAG)), np.array([0.4, 0.6])
    free = np.vstack([first, model.started(RISE[0], first).advance(RISE[1:])])
    np.testing.assert_allclose(model.predict(RISE, free)[1:], free[1:], rtol=1e-12)


def test_a_correction_replaces_the_newest_output():
    state = Members((LAG,)).started(np.zeros(2), np.ones(2))
    state.correct(np.array([7.0, np.nan]))
    state.correct(np.array([7.0, 4.0]))
    assert state.advance(np.zeros((1, 2)))[0, 0] == pytest.approx(0.6 * 4.0)


def test_a_stored_member_comes_back():
    assert Member.from_json(ARX.to_json()) == ARX
    with pytest.raises(ModelError) as caught:
        Member.from_json(ARX.to_json() | {"kind": "magic"})
    assert str(caught.value).startswith(
        "the part 'members', 'kind': Input should be 'steady_state'"
    )
