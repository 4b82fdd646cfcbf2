"""The ONNX graph of a model computes what `simulate` does."""

from types import ModuleType

import numpy as np
import pytest

from narxcal.export.onnx_graph import Graph, Number, run, traced
from narxcal.export.onnx_model import write_onnx
from narxcal.export.program import Program
from narxcal.export.proof import drawn, held
from narxcal.support.compiled import compiled
from narxcal.support.errors import ModelError
from tests.export import models

onnx = pytest.importorskip("onnx", reason="needs the extra export")
pytest.importorskip("onnxruntime", reason="needs onnxruntime")


@pytest.mark.parametrize("kind", models.KINDS)
def test_a_graph_is_simulate_from_equilibrium_and_in_mid_flight(kind, tmp_path):
    program = Program(models.KINDS[kind](), ["drawn at random"], "00ff")
    write_onnx(program, tmp_path / "engine.onnx")
    inputs = [held(drawn(program.envelope).inputs), models.log(300), models.log(300)[150:]]
    for found, given in zip(run(tmp_path / "engine.onnx", inputs), inputs, strict=True):
        np.testing.assert_allclose(found, program.model.simulate(given), rtol=0.0, atol=1e-9)


def test_the_file_says_what_it_is(tmp_path):
    program = Program(models.narx(models.fitted()), ["drawn at random"], "00ff")
    write_onnx(program, tmp_path / "engine.onnx")
    proto = onnx.load(str(tmp_path / "engine.onnx"))
    onnx.checker.check_model(proto, full_check=True)
    assert proto.opset_import[0].version == 18
    props = {one.key: one.value for one in proto.metadata_props}
    assert props["inputs"] == ",".join(models.INPUTS)
    assert (props["run_sha256"], props["dt_s"]) == ("00ff", "0.1")
    assert "NaN begins a run in equilibrium" in props["state"]


def test_one_run_of_a_batch_does_not_know_of_another(tmp_path):
    program = Program(models.KINDS["narx behind limited lags"]())
    write_onnx(program, tmp_path / "engine.onnx")
    inputs = [models.log(60), models.log(90)[::-1]]
    both = run(tmp_path / "engine.onnx", inputs)
    (alone,) = run(tmp_path / "engine.onnx", inputs[:1])
    np.testing.assert_allclose(both[0], alone, rtol=1e-12)


def branching(x, y):
    if x > y:
        return x * 2.0, y
    if y < 0.0:
        return -y, x
    return y, x


def changing(x, found):
    if x > 0.0:
        found[0] = x


def evaluated(graph, outputs, values):
    helper = onnx.helper
    nodes = [
        *graph.nodes,
        *(helper.make_node("Identity", [o.name], [f"o{k}"]) for k, o in enumerate(outputs)),
    ]
    kinds = [helper.make_tensor_value_info(n, 11, ["batch"]) for n in values]
    outs = [helper.make_tensor_value_info(f"o{k}", 11, ["batch"]) for k in range(len(outputs))]
    constants = [onnx.numpy_helper.from_array(a, n) for n, a in graph.constants.items()]
    model = helper.make_model(
        helper.make_graph(nodes, "g", kinds, outs, constants),
        opset_imports=[helper.make_opsetid("", 18)],
    )
    from onnx.reference import ReferenceEvaluator  # noqa: PLC0415

    return ReferenceEvaluator(model).run(None, values)


def module():
    made = ModuleType("made")
    for function in (branching, changing):
        function.__module__ = "made"
        setattr(made, function.__name__, compiled(function))
    return made


def test_a_function_with_branches_is_traced_both_ways():
    graph = Graph()
    x, y = Number(graph, "x"), Number(graph, "y")
    found = traced(module())["branching"](x, y)
    values = {"x": np.array([2.0, 0.0, -3.0]), "y": np.array([1.0, 1.0, -1.0])}
    got = evaluated(graph, found, values)
    expected = [branching(*row) for row in zip(*values.values(), strict=True)]
    np.testing.assert_array_equal(np.transpose(got), expected)


def test_a_branch_that_changes_an_array_or_stands_alone_is_refused():
    number = Number(Graph(), "x")
    with pytest.raises(ModelError, match="'changing' changes an array behind a branch"):
        traced(module())["changing"](number, [0.0])
    with pytest.raises(ModelError, match="a branch on a number stands outside of a function"):
        bool(number > 1.0)
