"""Static models: anchors of their sources, closed forms, oracles, and what bad input gives."""

import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import RectBivariateSpline
from scipy.optimize import brentq

from narxcal.atmosphere import air_state
from narxcal.static_models import (
    MODELS,
    Parameter,
    aerospatiale,
    bada3,
    build,
    cold_thrust,
    component_level,
    corrected,
    mattingly,
    outside,
    polynomial,
    spline_table,
    tensor,
    torenbeek,
    torenbeek_fuel,
    wanner,
    with_drag,
    yoder,
    yoder_plus,
)
from narxcal.static_models.black_box import Chebyshev, Spline
from narxcal.static_models.fuel import KGPH_PER_KN
from narxcal.static_models.thrust import gas_generator, generator
from narxcal.support.errors import ConfigError, DataError, ModelError


def row(**values):
    return {name: np.array([float(value)]) for name, value in values.items()}


def at_start(model, **values):
    return float(model.predict(model.starts, row(**values))[0])


# Anchors of EQUATIONS.md, part 2.
@pytest.mark.parametrize(
    ("alt", "mach", "share"),
    [(35_000, 0.8, 0.2892), (15_000, 0.5, 0.4951), (43_000, 0.9, 0.2273), (0, 0.0, 1.0)],
)
def test_mattingly_lapse(alt, mach, share):
    model = mattingly(1.0, throttle_degree=0)
    assert at_start(model, ALT_ft=alt, Mach=mach) == pytest.approx(share, abs=6e-5)


def test_aerospatiale_law():
    model = aerospatiale(1.0, throttle_degree=0)
    assert at_start(model, ALT_ft=35_000, Mach=0.8) == pytest.approx(0.1611, abs=5e-5)
    exponent = aerospatiale(1.0, k_is_exponent=True, throttle_degree=0)
    assert at_start(exponent, ALT_ft=35_000, Mach=0.8) == pytest.approx(0.1611, abs=5e-5)


def test_generator_function():
    assert gas_generator(np.array([4.5]), 16.0, (0.85, 0.88))[0] == pytest.approx(0.882, abs=5e-4)
    hot = row(EGT_C=1000 - 273.15, EPR=1.5)
    assert generator(hot, 0.85, 0.88)[0] == pytest.approx(0.186, abs=5e-4)


def test_generator_function_changes_sign_at_epr_1_063():
    low, high = (row(EGT_C=900 - 273.15, EPR=epr) for epr in (1.062, 1.064))
    assert np.isnan(generator(low, 0.85, 0.88)[0])
    assert 0.0 < generator(high, 0.85, 0.88)[0] < 0.002


@pytest.mark.parametrize(("mach", "share"), [(0.2, 0.789), (0.4, 0.684), (0.8, 0.790)])
def test_torenbeek_lapse_turns_up(mach, share):
    # ITT at which G_0 is 0.9 with a pressure ratio of 16: the anchors are at G = 0.9, B = 5.
    egt = brentq(lambda t: generator(row(EGT_C=t, EPR=16), 0.85, 0.88)[0] - 0.9, 900, 1400)
    found = at_start(torenbeek(1.0, 5.0), ALT_ft=0, Mach=mach, EGT_C=egt, EPR=16)
    assert found == pytest.approx(share, abs=6e-4)


@pytest.mark.parametrize(
    ("alt", "mach", "fpr", "newton"), [(20_000, 0.5, 1.4, 5965.0), (41_000, 0.8, 1.6, 3914.0)]
)
def test_cold_thrust(alt, mach, fpr, newton):
    # The anchor is the thrust of the fan stream, which is 75 % of the net thrust.
    found = at_start(cold_thrust(), ALT_ft=alt, Mach=mach, FPR=fpr)
    assert 750.0 * found == pytest.approx(newton, abs=1.0)


@pytest.mark.parametrize(("mach", "fpr"), [(0.5, 1.66), (0.7, 1.42), (0.8, 1.29), (0.9, 1.16)])
def test_cold_thrust_is_continuous_where_the_nozzle_chokes(mach, fpr):
    model = cold_thrust(flow="nozzle")
    x = np.linspace(fpr - 0.1, fpr + 0.1, 4001)
    p = model.starts
    values = model.predict(p, {"ALT_ft": 0 * x + 35e3, "Mach": 0 * x + mach, "FPR": x})
    steps = np.diff(values)
    assert np.all(steps > 0.0)
    assert steps.max() < 3.0 * np.median(steps)


def test_flows_of_cold_thrust_agree_where_their_areas_do():
    # At one condition the three flows differ by a constant of the area alone.
    condition = row(ALT_ft=30_000, Mach=0.7, FPR=1.5)
    found = [
        m.predict(m.starts, condition)[0]
        for m in (
            cold_thrust(0.5),
            cold_thrust(0.5, flow="nozzle"),
            cold_thrust(0.5, flow="corrected"),
        )
    ]
    for model, value in zip(("capture", "nozzle", "corrected"), found, strict=True):
        twice = cold_thrust(1.0, flow=model)
        assert twice.predict(twice.starts, condition)[0] == pytest.approx(2.0 * value, rel=1e-12)


def test_capture_flow_is_zero_at_rest_and_the_corrected_one_is_not():
    still = {"ALT_ft": 0, "Mach": 0, "FPR": 1.5}
    assert at_start(cold_thrust(), **still) == 0.0
    assert at_start(cold_thrust(flow="corrected"), **still) > 1.0
    assert at_start(cold_thrust(flow="nozzle"), **still) > 1.0


@pytest.mark.parametrize(
    ("alt", "mach", "T4", "ratio", "tsfc"),
    [(0, 0.0, 1450, 18, 0.340), (35_000, 0.8, 1350, 23, 0.622)],
)
def test_torenbeek_specific_fuel_consumption(alt, mach, T4, ratio, tsfc):
    model = torenbeek_fuel(5.0)
    found = at_start(model, ALT_ft=alt, Mach=mach, EGT_C=T4 - 273.15, EPR=ratio, FN_kN=1.0)
    assert found / KGPH_PER_KN == pytest.approx(tsfc, abs=5e-4)


def test_bada_and_its_units():
    mach = 450.0 / 661.4786  # 450 kt at sea level
    flow = at_start(bada3(), ALT_ft=0, Mach=mach, FN_kN=10.0)
    assert flow / 60.0 == pytest.approx(10.15, abs=1e-3)


def test_bada_phases():
    p = bada3("powered").starts
    condition = row(ALT_ft=10_000, Mach=0.3, FN_kN=1e-3)
    least = bada3("idle").predict(p, condition)
    assert least[0] == pytest.approx(60.0 * 5.0 * (1.0 - 1e4 / 8e4))
    assert bada3("powered").predict(p, condition) == least
    assert bada3("nominal").predict(p, condition) < least


@given(st.floats(0.0, 40_000.0), st.floats(0.2, 0.85), st.floats(1.2, 1.9), st.floats(1.0, 30.0))
def test_yoder_plus_is_yoder_where_its_terms_are_zero(alt, mach, fpr, thrust):
    condition = row(ALT_ft=alt, Mach=mach, FPR=fpr, FN_kN=thrust)
    plain, nested = yoder(30.0), yoder_plus(30.0)
    assert nested.predict([0.4, 0.45, 0.5, 6.0, 0.0, 0.0, 0.5], condition) == pytest.approx(
        plain.predict([0.4, 0.45, 0.5, 6.0], condition), rel=1e-12
    )


def test_drag_is_dynamic_pressure_times_area():
    columns = row(ALT_ft=25_000, Mach=0.6, TRA_deg=85)
    gross = mattingly(30.0)
    net = with_drag(gross, 2)
    p = np.append(gross.starts, [0.3, 0.2])
    q_kPa = 0.7e-3 * air_state(25_000, 0.6).P_Pa * 0.6**2
    lost = gross.predict(gross.starts, columns) - net.predict(p, columns)
    assert lost[0] == pytest.approx(q_kPa * (0.3 + 0.2 * 0.6), rel=1e-6)


@pytest.mark.parametrize(
    "model",
    [
        mattingly(30.0), torenbeek(30.0, 5.0, density_exponent=True, throttle_degree=1),
        aerospatiale(30.0), wanner(30.0), with_drag(wanner(30.0), 2), cold_thrust(),
        cold_thrust(variant="paper"), cold_thrust(flow="corrected"), torenbeek_fuel(5.0, fan=True),
        bada3(), yoder(30.0), yoder_plus(30.0),
    ],
    ids=lambda m: m.name,
)  # fmt: skip
def test_many_parameter_sets_at_once_are_each_alone(model):
    random = np.random.default_rng(3)
    n = 4
    columns = {
        "ALT_ft": random.uniform(0, 4e4, n), "Mach": random.uniform(0.3, 0.8, n),
        "TRA_deg": random.uniform(30, 80, n), "FPR": random.uniform(1.3, 1.8, n),
        "EPR": random.uniform(12, 20, n), "EGT_C": random.uniform(1000, 1200, n),
        "FN_kN": random.uniform(2, 20, n), "dT_C": np.zeros(n),
    }  # fmt: skip
    low, high = model.bounds
    sets = model.starts + 0.1 * random.random((5, len(low))) * (high - model.starts)
    together = model.equation(sets, columns)
    alone = np.array([model.equation(p, columns) for p in sets])
    np.testing.assert_allclose(together, alone, rtol=1e-12)


def test_component_level_model_is_the_engine():
    class Engine:
        input_names = ("TRA_deg", "ALT_ft")
        output_names = ("N1_pct", "FN_kN")

        def outputs(self, inputs):
            return np.column_stack([inputs[:, 0], inputs[:, 0] * inputs[:, 1]])

    model = component_level(Engine(), "FN_kN", ("TRA_deg", "ALT_ft"))
    found = model.predict([0.5], row(TRA_deg=4, ALT_ft=3))
    assert found == pytest.approx([6.0])


# Black boxes.
def grid(*axes):
    return [part.ravel() for part in np.meshgrid(*axes, indexing="ij")]


def mesh_columns(output, levers=(30.0, 40.0, 50.0, 60.0), altitudes=(5e3, 1e4, 2e4, 3e4)):
    tra, alt, mach = grid(levers, altitudes, np.linspace(0.3, 0.7, 5))
    columns = {"TRA_deg": tra, "ALT_ft": alt, "Mach": mach}
    return columns | {"FN_kN": output(tra, alt, mach)}


def solved(model, columns):
    return np.linalg.lstsq(model.design(columns), columns[model.output], rcond=None)[0]


def test_polynomial_reproduces_a_polynomial_beyond_its_rows():
    def truth(tra, alt, mach):
        return 3.0 + 1e-4 * alt * mach**2 - 0.02 * tra**2 * mach

    columns = mesh_columns(truth)
    model = polynomial(columns, "FN_kN", {"Mach": 2, "ALT_ft": 1, "TRA_deg": 2})
    new = {"TRA_deg": [37.0], "ALT_ft": [12_345.0], "Mach": [0.44]}
    found = model.predict(solved(model, columns), {k: np.array(v) for k, v in new.items()})
    assert found[0] == pytest.approx(truth(37.0, 12_345.0, 0.44), rel=1e-10)


def test_orthogonal_basis_is_well_conditioned_where_powers_are_singular():
    tra, mach = grid(np.linspace(30, 70, 12), np.linspace(0.3, 0.8, 12))
    columns = {"TRA_deg": tra, "Mach": mach, "FN_kN": tra}
    model = polynomial(columns, "FN_kN", {"TRA_deg": 5, "Mach": 5})
    powers = np.column_stack([tra**i * mach**j for i in range(6) for j in range(6)])
    assert np.linalg.cond(model.design(columns)) < 1e3
    assert np.linalg.cond(powers) > 1e12


def test_paper_s_two_steps_give_the_direct_fit():
    # Equations 18 and 19: a polynomial in (M, H) at every lever angle, then its coefficients
    # over the lever; three angles determine three coefficients, so both are the same.
    columns = mesh_columns(
        lambda t, a, m: np.sin(t / 20) * np.exp(-a / 2e4) * (1 + m**3), (30, 45, 60)
    )
    model = polynomial(columns, "FN_kN", {"Mach": 2, "ALT_ft": 2, "TRA_deg": 2})
    direct = model.predict(solved(model, columns), columns)
    inner = polynomial(columns, "FN_kN", {"Mach": 2, "ALT_ft": 2})
    at_angle = [
        solved(inner, {k: v[columns["TRA_deg"] == angle] for k, v in columns.items()})
        for angle in (30, 45, 60)
    ]
    two_steps = np.concatenate([
        inner.design({k: v[columns["TRA_deg"] == angle] for k, v in columns.items()}) @ p
        for angle, p in zip((30, 45, 60), at_angle, strict=True)
    ])  # fmt: skip
    np.testing.assert_allclose(direct, two_steps, rtol=1e-9)


def test_table_passes_through_its_nodes_and_is_the_tensor_spline_between():
    levers, altitudes = (30.0, 40.0, 50.0, 60.0, 70.0), (5e3, 1e4, 2e4, 3e4)

    def truth(tra, alt, mach):
        return np.exp(-alt / 3e4) * np.sqrt(tra) * (1.0 + mach)

    columns = mesh_columns(truth, levers, altitudes)
    model = spline_table(columns, "FN_kN", {"TRA_deg": levers, "ALT_ft": altitudes}, mach_degree=1)
    p = solved(model, columns)
    np.testing.assert_allclose(model.predict(p, columns), columns["FN_kN"], rtol=1e-10)
    at = {"TRA_deg": np.array([33.0, 66.0]), "ALT_ft": np.array([7e3, 2.6e4]),
          "Mach": np.array([0.5, 0.5])}  # fmt: skip
    nodes = truth(np.array(levers)[:, None], np.array(altitudes)[None, :], 0.5)
    oracle = RectBivariateSpline(levers, altitudes, nodes, kx=3, ky=3)
    np.testing.assert_allclose(
        model.predict(p, at), oracle.ev(at["TRA_deg"], at["ALT_ft"]), rtol=1e-9
    )


def test_table_of_three_nodes_is_linear_between_them():
    axis = Spline(column="x", nodes=(0.0, 1.0, 3.0))
    np.testing.assert_allclose(axis.values(np.array([0.5, 2.0])), [[0.5, 0.5, 0], [0, 0.5, 0.5]])


def test_table_with_holes_is_refused_and_names_them():
    columns = mesh_columns(lambda t, _a, _m: t)
    kept = ~((columns["TRA_deg"] == 40.0) & (columns["ALT_ft"] == 2e4))
    columns = {name: values[kept] for name, values in columns.items()}
    nodes = {"TRA_deg": (30, 40, 50, 60), "ALT_ft": (5e3, 1e4, 2e4, 3e4)}
    message = (
        "the table over TRA_deg x ALT_ft has 1 holes: fewer than 3 Mach numbers at 40 x 20000. "
        "Fly the missing nodes, leave their row out, or fit a polynomial"
    )
    with pytest.raises(DataError, match=f"^{message}$"):
        spline_table(columns, "FN_kN", nodes)


def test_rows_beyond_a_black_box_are_named():
    columns = mesh_columns(lambda t, _a, _m: t)
    for model in (
        polynomial(columns, "FN_kN", {"TRA_deg": 1, "Mach": 1}),
        spline_table(
            columns, "FN_kN", {"TRA_deg": (30, 40, 50, 60), "ALT_ft": (5e3, 1e4, 2e4, 3e4)}
        ),
    ):
        new = {"TRA_deg": np.array([29.0, 45.0, 45.0]), "Mach": np.array([0.5, 0.8, 0.5]),
               "ALT_ft": np.full(3, 6e3)}  # fmt: skip
        assert outside(model, new).tolist() == [True, True, False]


def test_a_correction_adds_to_any_model():
    base = bada3()
    columns = row(ALT_ft=1e4, Mach=0.5, FN_kN=10, FPR=1.4)
    extra = tensor("FF_kgph", [Chebyshev(column="FPR", degree=1, low=1.0, high=2.0)])
    model = corrected(base, extra)
    assert model.inputs == ("ALT_ft", "Mach", "FN_kN", "FPR")
    plain = base.predict(base.starts, columns)
    found = model.predict([*base.starts, 3.0, 5.0], columns)
    assert found - plain == pytest.approx([3.0 + 5.0 * (2.0 * 1.4 - 3.0)])


# What every model says of itself.
COLUMNS = mesh_columns(lambda t, _a, m: t * m) | {"FPR": np.linspace(1.2, 1.8, 80)}


@pytest.mark.parametrize("made", [
    mattingly(30.0), torenbeek(30.0, 5.0, density_exponent=True), aerospatiale(30.0), wanner(30.0),
    cold_thrust(0.4, flow="nozzle"), with_drag(mattingly(30.0, throttle_degree=1), 2, 0.5),
    torenbeek_fuel(5.0, fan=True), bada3("powered"), yoder(30.0), yoder_plus(30.0),
    corrected(cold_thrust(), polynomial(COLUMNS, "FN_kN", {"Mach": 2, "FPR": 1})),
    spline_table(COLUMNS, "FN_kN", {"TRA_deg": (30, 40, 50, 60), "ALT_ft": (5e3, 1e4, 2e4, 3e4)}),
], ids=lambda m: m.name)  # fmt: skip
def test_a_model_is_built_again_from_its_recipe(made):
    again = build(json.loads(json.dumps(made.recipe)))
    assert again.parameters == made.parameters
    assert (again.name, again.inputs) == (made.name, made.inputs)
    random = np.random.default_rng(0)
    columns = {name: random.uniform(1.2, 1.4, 3) for name in (*made.inputs, "dT_C")}
    p = made.starts + 0.1
    np.testing.assert_array_equal(again.equation(p, columns), made.equation(p, columns))


def test_an_unknown_model_lists_the_known_ones():
    message = f"^unknown static model 'rolls'. Known: {', '.join(MODELS)}$"
    with pytest.raises(ModelError, match=message):
        build({"model": "rolls"})


# Bad input.
def test_a_missing_channel_is_named():
    message = (
        r"^the model 'Cold Thrust' needs ALT_ft, Mach, FPR; missing: Mach, FPR\. "
        r"Add the channel to the logs or choose a model without it$"
    )
    with pytest.raises(DataError, match=message):
        at_start(cold_thrust(), ALT_ft=1e4)


def test_a_generator_function_below_zero_names_the_rows():
    model = torenbeek(30.0, 5.0)
    columns = {"ALT_ft": np.full(3, 1e4), "Mach": np.full(3, 0.5), "EGT_C": np.full(3, 626.85),
               "EPR": np.array([1.5, 1.05, 1.02])}  # fmt: skip
    message = (
        r"^Torenbeek: the generator function is not above zero \(EPR too near one for this ITT\) "
        r"in rows 1, 2 \(2 of 3\)$"
    )
    with pytest.raises(ModelError, match=message):
        model.predict(model.starts, columns)


def test_nan_in_an_input_is_nan_in_that_row_only():
    columns = {"ALT_ft": np.array([1e4, math.nan]), "Mach": np.array([0.5, 0.5]),
               "FN_kN": np.array([3.0, 3.0])}  # fmt: skip
    found = bada3().predict(bada3().starts, columns)
    assert np.isfinite(found).tolist() == [True, False]


def test_columns_of_different_length_are_refused():
    columns = {"ALT_ft": np.zeros(2), "Mach": np.zeros(3), "FN_kN": np.zeros(2)}
    with pytest.raises(DataError, match=r"^BADA 3: expected columns of one length, found"):
        bada3().predict(bada3().starts, columns)


@pytest.mark.parametrize(("make", "message"), [
    (lambda: Parameter("a", 2.0, 0.0, 1.0),
     "^parameter 'a': expected low <= start <= high and low < high, found 0, 2, 1$"),
    (lambda: Spline(column="x", nodes=(1.0, 1.0)),
     r"^table over x: expected two or more ascending nodes, found \(1.0, 1.0\)$"),
    (lambda: Chebyshev(column="x", degree=-1, low=0.0, high=1.0),
     r"^polynomial in x: expected degree >= 0 and low < high, found degree -1 over 0 \.\. 1$"),
    (lambda: cold_thrust(variant="paper", flow="nozzle"),
     "^Cold Thrust: variant 'paper' has flow 'capture' only, found 'nozzle'$"),
])  # fmt: skip
def test_impossible_settings_are_refused(make, message):
    with pytest.raises(ConfigError, match=message):
        make()


def test_a_column_that_never_changes_is_refused():
    columns = row(Mach=0.5, FN_kN=3.0)
    with pytest.raises(DataError, match=r"^channel Mach: every row is 0\.5: no polynomial can be"):
        polynomial(columns, "FN_kN", {"Mach": 1})
