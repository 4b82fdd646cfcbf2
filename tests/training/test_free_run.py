"""The compiled free run and its derivatives against PyTorch, which is slow and exact."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from narxcal.narx import kernels
from narxcal.narx.module import NarxNet
from narxcal.narx.network import AT_START, NarxConfig, NarxModel, Scaling
from narxcal.record import Record
from training.dynamics import free_run
from training.dynamics.free_run import FreeRunProblem, cut_windows
from training.dynamics.network import net_of
from training.dynamics.optimisers import adam, minimise


def make_model(config: NarxConfig, inputs: int = 3, outputs: int = 2, seed: int = 0) -> NarxModel:
    torch.manual_seed(seed)
    net = NarxNet(config, inputs, outputs)
    net.low[:] = -0.6
    net.high[:] = 0.5
    rng = np.random.default_rng(seed)
    return NarxModel(
        net,
        Scaling(rng.normal(size=inputs), 1 + rng.random(inputs)),
        Scaling(np.zeros(outputs), 1 + rng.random(outputs)),
    )


def make_record(time: int = 60, inputs: int = 3, outputs: int = 2, seed: int = 1) -> Record:
    rng = np.random.default_rng(seed)
    y = rng.normal(size=(time, outputs))
    y[7:11, 0] = np.nan
    return Record(rng.normal(size=(time, inputs)), y, weight=rng.random(time))


configs = st.builds(
    NarxConfig,
    lags=st.integers(1, 4),
    taps=st.sampled_from([(0,), (0, 1), (1, 2), (0, 3, 7)]),
    hidden=st.integers(1, 17),
    moving=st.integers(0, 2),
)


@settings(max_examples=15)
@given(config=configs, given_samples=st.integers(1, 6), seed=st.integers(0, 99))
def test_compiled_free_run_equals_one_pytorch_call_a_step(config, given_samples, seed):
    model = make_model(config, seed=seed)
    record = make_record(seed=seed)
    start = np.nan_to_num(record.y[:given_samples])
    fast = model.simulate(record.u, start)
    with torch.no_grad():
        slow = (
            net_of(model)
            .free_run_by_steps(
                torch.from_numpy(model.output_scaling.down(start))[None],
                torch.from_numpy(model.input_scaling.down(record.u))[None],
            )[0]
            .numpy()
        )
    np.testing.assert_allclose(fast, model.output_scaling.up(slow), rtol=1e-12, atol=1e-12)


@settings(max_examples=15)
@given(config=configs, first=st.integers(1, 6), seed=st.integers(0, 99))
def test_the_differentiable_free_run_is_that_of_the_steps_and_so_are_its_slopes(
    config, first, seed
):
    net = net_of(make_model(config, seed=seed))
    found = []
    for run in (net.free_run, net.free_run_by_steps):
        random = np.random.default_rng(seed)
        start = torch.tensor(random.normal(size=(3, first, 2)) * 0.2, requires_grad=True)
        u = torch.tensor(random.normal(size=(3, 25, 3)), requires_grad=True)
        net.zero_grad()
        y = run(start, u)
        (y**2 * torch.arange(25.0, dtype=torch.float64)[:, None]).sum().backward()
        slopes = [start.grad, u.grad, *(weights.grad for weights in net.parameters())]
        found.append([y.detach(), *slopes])
    for fast, slow in zip(*found, strict=True):
        np.testing.assert_allclose(fast.numpy(), slow.numpy(), rtol=1e-10, atol=1e-10)


def test_slopes_of_the_differentiable_free_run_are_those_of_finite_differences():
    net = net_of(make_model(NarxConfig(lags=2, taps=(0, 2), hidden=3, moving=1)))
    random = np.random.default_rng(0)
    start = torch.tensor(random.normal(size=(2, 1, 2)) * 0.2, requires_grad=True)
    u = torch.tensor(random.normal(size=(2, 9, 3)), requires_grad=True)
    assert torch.autograd.gradcheck(net.free_run, (start, u))


@pytest.mark.parametrize("optimiser", [torch.optim.SGD, torch.optim.AdamW, torch.optim.LBFGS])
def test_any_optimiser_of_torch_trains_the_network_by_any_loss(optimiser):
    truth, net = (net_of(make_model(NarxConfig(hidden=4), outputs=1, seed=k)) for k in (0, 1))
    u = torch.tensor(np.random.default_rng(0).normal(size=(8, 30, 3)))
    start = torch.zeros(8, 1, 1, dtype=torch.float64)
    target = truth.free_run(start, u).detach()
    descent = optimiser(net.parameters(), lr=0.05)

    def loss():
        descent.zero_grad()
        error = torch.nn.functional.huber_loss(net.free_run(start, u), target, delta=0.1)
        error.backward()
        return error

    before = loss().item()
    for _ in range(60):
        descent.step(loss)
    assert loss().item() < 0.5 * before


@pytest.mark.parametrize("values", [np.linspace(-30, 30, 4001), np.linspace(-1e-3, 1e-3, 4001)])
def test_tanh_of_all_units_at_once_is_exact_to_the_last_digits(values):
    found = np.empty_like(values)
    kernels.tanh_of(values, found)
    np.testing.assert_allclose(found, np.tanh(values), rtol=1e-15, atol=0.0)
    limits = np.array([np.nan, np.inf, -np.inf, 0.0, 1e-300])
    kernels.tanh_of(limits, found[:5])
    np.testing.assert_array_equal(found[:5], np.tanh(limits))


def autograd(model, windows, theta):
    """Loss and gradient by PyTorch through every step."""
    net = net_of(model)
    net.set_theta(theta)
    net.zero_grad()
    lags, taps, inputs = net.config.lags, len(net.config.taps), net.inputs
    loss = torch.zeros((), dtype=torch.float64)
    for window in windows:
        past = torch.from_numpy(window.history).reshape(1, lags, -1)
        for k in range(len(window.tapped)):
            past_u = torch.from_numpy(window.tapped[k]).reshape(1, taps, inputs)
            y = net(past, past_u)
            error = (y[0] - torch.from_numpy(window.target[k])) * torch.from_numpy(
                window.root_weight[k]
            )
            loss = loss + 0.5 * (error**2).sum()
            past = torch.cat([y[:, None], past[:, :-1]], dim=1)
    loss.backward()
    weights = dict(net.named_parameters())
    names = ("hidden.weight", "hidden.bias", "output.weight", "output.bias", "linear.weight")
    return loss.item(), np.concatenate(
        [
            np.zeros(weights[n].numel())
            if weights[n].grad is None
            else weights[n].grad.numpy().ravel()
            for n in names
        ]
    )


@settings(max_examples=10)
@given(config=configs, horizon=st.sampled_from([None, 5, 17]), seed=st.integers(0, 99))
def test_both_gradients_equal_autograd(config, horizon, seed):
    model = make_model(config, seed=seed)
    windows = cut_windows(model, [make_record(time=40, seed=seed)], horizon)
    theta = net_of(model).get_theta()
    problem = FreeRunProblem(net_of(model), windows, threads=2)
    loss, gradient = autograd(model, windows, theta)
    by_adjoint = problem.gradient(theta)
    by_sensitivity = problem.normal_equations(theta)
    assert problem.loss(theta) == pytest.approx(loss)
    assert by_adjoint[0] == pytest.approx(loss)
    np.testing.assert_allclose(by_adjoint[1], gradient, rtol=1e-7, atol=1e-10)
    np.testing.assert_allclose(by_sensitivity.gradient, gradient, rtol=1e-7, atol=1e-10)


@pytest.mark.parametrize("block", [1, 2, 7, 40])
@pytest.mark.parametrize("horizon", [None, 9])
def test_sensitivities_in_blocks_are_those_in_one(block, horizon, monkeypatch):
    """Also where a block is shorter than the history, and where windows begin within one."""
    model = make_model(NarxConfig(hidden=3, lags=4))
    windows = cut_windows(model, [make_record(time=40)], horizon)
    theta = net_of(model).get_theta()
    whole = FreeRunProblem(net_of(model), windows).normal_equations(theta)
    monkeypatch.setattr(free_run, "_BLOCK", block)
    found = FreeRunProblem(net_of(model), windows).normal_equations(theta)
    np.testing.assert_allclose(found.gradient, whole.gradient, rtol=1e-9)
    np.testing.assert_allclose(found.hessian, whole.hessian, rtol=1e-9)


def test_gauss_newton_matrix_is_the_jacobian_squared():
    model = make_model(NarxConfig(hidden=3))
    windows = cut_windows(model, [make_record()], None)
    theta = net_of(model).get_theta()
    problem = FreeRunProblem(net_of(model), windows)

    def residual(at):
        net_of(model).set_theta(at)
        history = windows[0].history[None]
        y = net_of(model).weights().run(windows[0].tapped, (AT_START, history))[0]
        return ((y - windows[0].target) * windows[0].root_weight).ravel()

    step = 1e-6
    jacobian = np.stack(
        [
            (residual(theta + step * e) - residual(theta - step * e)) / (2 * step)
            for e in np.eye(len(theta))
        ],
        axis=1,
    )
    hessian = problem.normal_equations(theta).hessian
    np.testing.assert_allclose(hessian, jacobian.T @ jacobian, rtol=1e-4, atol=1e-8)


def test_weights_taken_out_of_a_network_stay_when_it_is_given_others():
    net = net_of(make_model(NarxConfig(lags=1, hidden=1), outputs=1))
    weights = net.weights()
    kept = [array.copy() for array in (weights.w1, weights.b1, weights.a)]
    net.set_theta(net.get_theta() + 1.0)
    now = (weights.w1, weights.b1, weights.a)
    assert all(np.array_equal(one, other) for one, other in zip(kept, now, strict=True))


def test_whatever_the_input_a_free_run_stays_inside_its_bounds():
    model = make_model(NarxConfig())
    u = 1e3 * np.random.default_rng(0).normal(size=(5000, 3))
    y = model.simulate(u, np.zeros(2))[1:]
    low, high = model.bounds
    assert (y >= low - 1e-12).all()
    assert (y <= high + 1e-12).all()


def test_an_anchored_network_rests_at_zero_when_nothing_moves():
    model = make_model(NarxConfig(moving=1, hidden=4))
    model.input_scaling.centre[0] = 0.0
    u = np.tile([0.0, 3.0, -2.0], (100, 1))
    np.testing.assert_allclose(model.simulate(u, np.zeros(2)), 0.0, atol=1e-12)


def test_windows_do_not_change_the_set_of_scored_samples():
    model = make_model(NarxConfig())
    record = make_record(time=200)
    whole = cut_windows(model, [record], None, stride=3)
    cut = cut_windows(model, [record], 20, stride=3)
    lags = model.config.lags
    roots = np.concatenate([w.root_weight for w in cut])
    expected = whole[0].root_weight[lags - 1 :]
    np.testing.assert_array_equal(roots > 0, expected > 0)


@pytest.mark.slow
@pytest.mark.parametrize("how", ["lm", "adam"])
def test_linear_feedback_stays_linear_whatever_trains_it(how):
    config = NarxConfig(lags=2, taps=(0, 1), hidden=3, moving=1, linear_feedback=True)
    model = make_model(config)
    with torch.no_grad():
        net_of(model).output.weight.fill_(0.1)
    problem = FreeRunProblem(net_of(model), cut_windows(model, [make_record()], 20))
    theta = net_of(model).get_theta()
    lm = how == "lm"
    steps = minimise(problem, theta) if lm else adam(problem, theta, 0.01)
    for _, step in zip(range(5), steps, strict=False):
        net_of(model).set_theta(step.theta)
    assert not net_of(model).hidden.weight[:, :4].any()
    assert (net_of(model).get_theta() != theta)[net_of(model).trained() == 1.0].mean() > 0.6


def test_whole_records_are_run_from_several_places_with_the_measured_history():
    model = make_model(NarxConfig(lags=3))
    record = make_record(time=90)
    windows = cut_windows(model, [record], None, restarts=3)
    assert [len(window.target) for window in windows] == [89, 60, 30]
    scaled = model.output_scaling.down(record.y)
    for window, first in zip(windows[1:], (30, 60), strict=True):
        np.testing.assert_allclose(window.target, scaled[first:])
        np.testing.assert_allclose(window.history, scaled[first - 1 : first - 4 : -1].ravel())
    assert sum((window.root_weight**2).sum() for window in windows) == pytest.approx(1.0)
    short = cut_windows(model, [make_record(time=3)], None, restarts=9)
    assert all(len(window.target) for window in short)
