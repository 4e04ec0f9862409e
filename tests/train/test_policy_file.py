"""Policy files: what is in them, and what is said of those that are none."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("onnx", reason="needs skincal[train]")

import onnx
from onnx import TensorProto, helper, numpy_helper

from skincal.errors import InputError, WorkError
from skincal.train import Description, Network, PolicyKind, Task, bundled_policies, policy_path, read_policy
from skincal.train.onnx_file import as_onnx, write_policy

ABOUT = Description(
    task=Task.marble,
    policy=PolicyKind.tactile,
    observation=({"name": "policy", "size": 6},),
    actions=2,
    ranges_sha256="0" * 64,
    seed=1,
    steps=480,
    wall_time_s=1.5,
    backend="sb3",
)


def network(seed: int = 1, inputs: int = 6) -> Network:
    rng = np.random.default_rng(seed)
    layers = [
        (rng.normal(size=(inputs, 5)), rng.normal(size=5)),
        (rng.normal(size=(5, 2)), rng.normal(size=2)),
    ]
    return Network.build(rng.normal(size=inputs), rng.uniform(0.1, 3, inputs), 10.0, layers)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    write_policy(network(), ABOUT, tmp_path / "policy.onnx")
    return tmp_path / "policy.onnx"


def test_the_graph_computes_what_the_network_does(file):
    observations = 3.0 * np.random.default_rng(2).normal(size=(50, 6))
    np.testing.assert_array_equal(read_policy(file)(observations), network()(observations))
    onnxruntime = pytest.importorskip("onnxruntime")
    session = onnxruntime.InferenceSession(file, providers=["CPUExecutionProvider"])
    (actions,) = session.run(None, {"observation": observations.astype(np.float32)})
    np.testing.assert_allclose(actions, network()(observations), atol=1e-6)


def test_it_holds_nothing_but_plain_operators(file):
    model = onnx.load(file)
    assert {node.op_type for node in model.graph.node} == {"Sub", "Mul", "Clip", "Gemm", "Relu", "Tanh"}
    assert not model.functions
    assert all(not value.external_data for value in model.graph.initializer)


def test_the_description_comes_back(file):
    assert read_policy(file).description == ABOUT


def test_it_is_the_same_bytes_again(file, tmp_path):
    write_policy(network(), ABOUT, tmp_path / "again.onnx")
    assert (tmp_path / "again.onnx").read_bytes() == file.read_bytes()


def test_an_existing_file_stays(file):
    with pytest.raises(InputError, match="--force"):
        write_policy(network(), ABOUT, file)


@pytest.mark.parametrize(
    ("make", "got"),
    [
        (lambda p: None, "no such file"),
        (lambda p: p.mkdir(), "is a directory"),
        (lambda p: p.write_bytes(b""), "no ONNX model"),
        (lambda p: p.write_bytes(b"not a model at all"), "no ONNX model"),
        (lambda p: p.write_bytes(np.random.default_rng(1).bytes(5000)), "no ONNX model"),
    ],
)
def test_files_that_are_no_policy(tmp_path, make, got):
    path = tmp_path / "other.onnx"
    make(path)
    with pytest.raises(InputError) as caught:
        read_policy(path)
    assert f"{path}: expected a policy written by `skincal train` (.onnx); got" in str(caught.value)
    assert got in str(caught.value)


FAULTY: list[dict[str, object]] = [
    {"environment": "x"}, {"environment": {"speed_rad_per_s": [1]}}, {"seed": "1"}, {"wall_time_s": "1"},
    {"wall_time_s": True}, {"versions": ["x"]}, {"created": 1}, {"backend": None},
    {"observation": [{"name": "image", "size": 6, "steps_ago": 10**18}]},
    {"observation": [{"name": "image", "size": 6, "steps_ago": -5}]},
    {"observation": [{"name": "image", "size": 6, "steps_ago": "x"}]},
    {"observation": [{"name": ["image"], "size": 6}]},
    {"observation": 7}, {"observation": [{"name": "policy"}]}, {"observation": [{"name": "policy", "size": 10**400}]},
]  # fmt: skip


@pytest.mark.parametrize(
    ("about", "got"),
    [
        *((about, "a description with a fault") for about in FAULTY),
        ({"format": "skincal-policy/9"}, "skincal-policy/9"),
        ({"task": "pen"}, 'got "pen"'),
        ({"actions": 3}, "described as one from"),
        ({"observation": [{"name": "policy", "size": 7}]}, "described as one from"),
        (
            {"observation": [{"name": "policy", "size": -6}, {"name": "x", "size": 12}]},
            "a size of 1 to 1048575; got -6",
        ),
    ],
)
def test_descriptions_with_a_fault(tmp_path, about, got):
    model = as_onnx(network(), ABOUT)
    model.metadata_props[0].value = json.dumps({**ABOUT.as_table(), **about})
    (tmp_path / "p.onnx").write_bytes(model.SerializeToString())
    with pytest.raises(InputError) as caught:
        read_policy(tmp_path / "p.onnx")
    assert got in str(caught.value)


def test_a_foreign_onnx_file(tmp_path):
    model = as_onnx(network(), ABOUT)
    del model.metadata_props[:]
    (tmp_path / "p.onnx").write_bytes(model.SerializeToString())
    with pytest.raises(InputError, match="an ONNX model without a description"):
        read_policy(tmp_path / "p.onnx")


def test_a_file_that_points_to_other_files_is_refused(tmp_path, monkeypatch):
    """Weights may stand outside an ONNX file; a policy that reads other files is no policy."""
    monkeypatch.chdir(tmp_path)
    Path("secret.bin").write_bytes(np.zeros(30, np.float32).tobytes())
    model = as_onnx(network(), ABOUT)
    weight = next(value for value in model.graph.initializer if value.name == "weight_0")
    onnx.external_data_helper.set_external_data(weight, "secret.bin")
    weight.ClearField("raw_data")
    (tmp_path / "p.onnx").write_bytes(model.SerializeToString())
    with pytest.raises(InputError, match="no ONNX model"):
        read_policy(tmp_path / "p.onnx")
    with pytest.raises(InputError, match="no ONNX model"):
        weight.external_data[0].value = str(tmp_path / "secret.bin")
        (tmp_path / "p.onnx").write_bytes(model.SerializeToString())
        read_policy(tmp_path / "p.onnx")


def _numbers(model: onnx.ModelProto, name: str) -> onnx.TensorProto:
    return next(value for value in model.graph.initializer if value.name == name)


def _not_finite(model: onnx.ModelProto) -> None:
    _numbers(model, "bias_1").raw_data = np.array([0.0, np.nan], np.float32).tobytes()


def _without_tanh(model: onnx.ModelProto) -> None:
    model.graph.node[-1].op_type = "Identity"


def _with_loop(model: onnx.ModelProto) -> None:
    body = helper.make_graph([], "body", [], [])
    model.graph.node.append(helper.make_node("Loop", ["rounds", ""], ["more"], body=body))
    model.graph.initializer.append(numpy_helper.from_array(np.array(10**12), "rounds"))


def _with_attribute(model: onnx.ModelProto) -> None:
    model.graph.node[3].attribute.append(helper.make_attribute("alpha", 1e30))


def _too_few_numbers(model: onnx.ModelProto) -> None:
    _numbers(model, "weight_0").dims[0] = 2**40


def _of_other_shape(model: onnx.ModelProto) -> None:
    _numbers(model, "weight_0").dims[:] = [5, 6]


def _with_function(model: onnx.ModelProto) -> None:
    model.functions.append(helper.make_function("other", "f", [], [], [], []))


def _with_other_clip(model: onnx.ModelProto) -> None:
    _numbers(model, "low").CopyFrom(helper.make_tensor("low", TensorProto.FLOAT, [1], b"\0\0\0\0", raw=True))


CHANGES = (_not_finite, _without_tanh, _with_loop, _with_attribute, _too_few_numbers, _of_other_shape,
           _with_function, _with_other_clip)  # fmt: skip


@pytest.mark.parametrize("change", CHANGES)
def test_only_what_train_writes_is_read(tmp_path, change):
    model = as_onnx(network(), ABOUT)
    change(model)
    (tmp_path / "p.onnx").write_bytes(model.SerializeToString())
    with pytest.raises(InputError, match=r"p\.onnx: expected a policy written by `skincal train`"):
        read_policy(tmp_path / "p.onnx")


def test_a_description_that_is_no_text(tmp_path):
    content = as_onnx(network(), ABOUT).SerializeToString()
    (tmp_path / "p.onnx").write_bytes(content.replace(b'"created"', b'"crea\xffed"'))
    with pytest.raises(InputError, match=r"p\.onnx"):
        read_policy(tmp_path / "p.onnx")


def test_actions_are_numbers(file):
    with pytest.raises(WorkError, match="actions within"):
        read_policy(file)(np.full(6, np.nan))


def test_names(file, tmp_path):
    assert policy_path(file) == file
    with pytest.raises(InputError, match="expected a policy file"):
        policy_path(tmp_path / "nothing.onnx")
    for name, path in bundled_policies().items():
        assert policy_path(name) == path


def test_bundled_policies_are_sound():
    for name, path in bundled_policies().items():
        policy = read_policy(path)
        assert name.startswith(f"{policy.description.task}-{policy.description.policy}")
        assert np.abs(policy(np.zeros(policy.description.size))).max() <= 1.0
