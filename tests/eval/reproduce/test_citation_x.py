"""The Citation X study: its mesh, its tables and claims, and the tutorial page."""

import json
import re

import numpy as np
import pandas as pd
import pytest

from eval.reproduce.citation_dynamic import merged
from eval.reproduce.citation_static import (
    HIGH,
    KINDS,
    LOW,
    MOVED,
    ONSET_S,
    OUTPUTS,
    RAMP_S,
    T_S,
    TIME_S,
    TRA_PER_TLA,
    Engines,
    Region,
    disturbances,
    lever,
    mach_range,
    static_flights,
)
from eval.reproduce.citation_x import cold_share, reproduce
from eval.reproduce.study import missed
from narxcal.turbofan import VirtualEngine
from narxcal.turbofan.engine import HIGH as CEILING

SMALL = (
    Region("low", (5e3, 10e3, 15e3, 20e3), (25.0, 35.0, 42.5, 50.0)),
    Region("high", (30e3, 33e3, 36e3, 40e3), (35.0, 40.0, 45.0, 50.0)),
)


@pytest.fixture(scope="module")
def engine():
    return VirtualEngine("single_aisle")


# The mesh.
@pytest.mark.parametrize("region", [LOW, HIGH])
def test_validation_flights_lie_in_the_middle_of_every_cell(region):
    known, new = region.nodes("identification"), region.nodes("validation")
    for nodes, middles in zip(known, new, strict=True):
        assert len(middles) == len(nodes) - 1
        np.testing.assert_allclose(middles, 0.5 * (np.array(nodes[1:]) + nodes[:-1]))
        assert not set(middles) & set(nodes)
    assert max(known[0]) <= CEILING[1]


@pytest.mark.parametrize("region", [LOW, HIGH])
@pytest.mark.parametrize("role", ["identification", "validation"])
def test_disturbances_stay_within_what_was_identified(region, role):
    altitudes, amplitudes = region.conditions(role)
    assert all(0.0 < a <= region.tla_deg[-1] - region.least_tla for a in amplitudes)
    for alt in altitudes:
        # Trim at the least lever angle lies in the Mach range of every greater one.
        _, held = mach_range(region, alt, region.least_tla)
        for amplitude in amplitudes:
            slow, fast = mach_range(region, alt, region.least_tla + amplitude)
            assert slow < held <= fast <= 0.85


def test_the_three_disturbances():
    t = TIME_S
    assert t[MOVED] > ONSET_S == pytest.approx(t[MOVED - 1])
    step, impulse, ramp = (lever(kind, t, 25.0, 10.0) for kind in KINDS)
    assert np.all(step[t <= ONSET_S] == 25.0)
    assert np.all(step[t > ONSET_S + 1e-9] == 35.0)
    assert np.sum(impulse == 35.0) == 1
    assert impulse[-1] == 25.0
    assert ramp[t >= ONSET_S + RAMP_S][0] == pytest.approx(35.0)
    assert np.max(np.diff(ramp)) == pytest.approx(10.0 * T_S / RAMP_S)


def test_static_flights_are_accelerated_cruises(engine):
    region = Region("high", (30e3, 40e3), (35.0, 50.0))
    rows = static_flights(engine, region, "identification")
    assert sorted(set(rows["TRA_deg"])) == pytest.approx([35.0 * TRA_PER_TLA, 50.0 * TRA_PER_TLA])
    for flight in range(4):
        own = rows["flight"] == flight
        assert np.all(np.diff(rows["Mach"][own]) > 0.0)
        assert len(set(rows["ALT_ft"][own])) == 1


def test_disturbances_start_in_equilibrium(engine):
    for flight in disturbances(
        engine, Region("low", (5e3, 9e3), (25.0, 40.0)), "validation", "step"
    ):
        for name in OUTPUTS:
            quiet = flight.columns[name][: MOVED + 1]
            assert np.ptp(quiet) < 2e-3 * quiet[0]
            assert abs(flight.columns[name][-1] - quiet[0]) > 0.01 * quiet[0]


# The study.
@pytest.fixture(scope="module")
def found():
    estimators = ("levenberg-marquardt", "swarm")
    return reproduce("single_aisle", regions=SMALL, estimators=estimators)


@pytest.fixture(scope="module")
def claims(found):
    return [claim for study in found for claim in study.claims]


@pytest.mark.slow
def test_figures_10_to_15_are_drawn(found):
    captions = " ".join(picture.caption for picture in found[1].pictures)
    assert captions.startswith("Figures 10 and 11")
    assert all(f"Figure {number}:" in captions for number in range(12, 16))
    assert all("<svg" in picture.svg for picture in found[1].pictures)


@pytest.mark.slow
def test_the_reach_is_met(found, claims):
    named = {claim.what: claim for claim in claims}
    for what in (
        "C1 Cold Thrust, high: mean error", "C1 Cold Thrust, high: success",
        "C2 Yoder+, high: mean error", "C2 Yoder+, high: success",
    ):  # fmt: skip
        assert named[what].met, what
    rows = found[0].results["rows"]
    reach = {"Cold Thrust + correction (M, FPR)": 1.0, "Yoder+": 1.4}
    own = [row for row in rows if row["model"] in reach]
    assert len(own) == 4  # two regions
    for row in own:
        for case in ("validation", "chained"):
            assert row[case]["mean_pct"] <= reach[row["model"]]
            assert row[case]["success_pct"] >= 99.7


@pytest.mark.slow
def test_every_claim_of_the_paper_is_measured(claims):
    numbers = {int(re.match(r"C(\d+) ", claim.what)[1]) for claim in claims}
    assert numbers == set(range(1, 16))
    assert all(claim.met is not None for claim in claims)
    held = {claim.what for claim in claims if claim.met}
    # Signs that do not depend on the size of the mesh.
    assert any(what.startswith("C3 Yoder+") for what in held)
    assert any(what.startswith("C5 FN_kN") for what in held)
    assert any(what.startswith("C7 correction, low: identification") for what in held)
    assert any(what.startswith("C9 ITT settles last") for what in held)
    assert any(
        what.startswith("C13 step: mean error, 1 parameter over 30 (C = I)") for what in held
    )
    assert any(what.startswith("C14 ") for what in held)
    assert any(what.startswith("C15 step") for what in held)


@pytest.mark.slow
def test_interpolated_matrices_diverge_and_the_modal_form_does_not(found):
    rows = found[1].results["rows"]

    def worst(model):
        return max(row["mean_pct"] for row in rows if row["model"] == model)

    assert worst("5/O O/5 (C = I)") > 100.0
    assert worst("5/O O/5") < 10.0


@pytest.mark.slow
def test_the_rows_are_json_and_missed_claims_are_counted(found, claims):
    rows = json.loads(json.dumps([study.row() for study in found], allow_nan=True))
    assert [row["study"] for row in rows] == ["static", "dynamic"]
    assert len(missed(found)) == sum(claim.met is False for claim in claims)


@pytest.mark.slow
def test_failures_are_named_and_not_left_out(found):
    rows = found[0].results["rows"]
    assert all((row["fit"] is None) == bool(row["failure"]) for row in rows)


def test_the_cold_part_is_about_three_quarters_of_thrust():
    engines = Engines("business_jet")

    class Study:
        validation = static_flights(engines.designed, HIGH, "validation")

    assert cold_share(engines, Study) == pytest.approx(0.75, abs=0.02)


def test_rows_are_pooled_by_flights():
    names = ["mean_pct", "worst_pct", "success_pct", "identified_pct", "flights"]
    rows = pd.DataFrame([(1.0, 5.0, 100.0, 50.0, 3), (5.0, 9.0, 0.0, 90.0, 1)], columns=names)
    rows[["kind", "model", "output"]] = "step", "m", "FPR"
    static = rows.assign(model="static model", success_pct=np.nan)
    one, other = merged(pd.concat([rows, static]))[names].to_numpy()
    assert one.tolist() == [2.0, 9.0, 75.0, 60.0, 4]
    np.testing.assert_equal(other, [2.0, 9.0, np.nan, 60.0, 4])
