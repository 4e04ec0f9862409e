"""A policy as an ONNX file: normalisation, layers and a description; no code is in it."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from skincal.bounded import UnreadableError, parse_json
from skincal.dataset.findings import Findings
from skincal.dataset.schema import read_table
from skincal.errors import InputError, text_of
from skincal.files import whole_file
from skincal.train.policy_file import DESCRIPTION_KEY, FORMAT, INPUT, OUTPUT, Description, Network

OPSET: Final = 17
IR_VERSION: Final = 8


def write_policy(
    network: Network, description: Description, path: str | Path, *, force: bool = False
) -> None:
    """Write a policy file; it appears whole or not at all."""
    content = as_onnx(network, description).SerializeToString()
    with whole_file(path, force=force) as temporary:
        temporary.write_bytes(content)


def as_onnx(network: Network, description: Description) -> onnx.ModelProto:
    """Return the graph: subtract, scale, clip, then a matrix product, a sum and a bend for every layer."""
    numbers = _numbers(network)
    graph = helper.make_graph(
        _nodes(len(network.weights)),
        "policy",
        [helper.make_tensor_value_info(INPUT, TensorProto.FLOAT, ["N", network.observations])],
        [helper.make_tensor_value_info(OUTPUT, TensorProto.FLOAT, ["N", network.actions])],
        [numpy_helper.from_array(value, name) for name, value in numbers.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], producer_name="skincal")
    model.ir_version = IR_VERSION
    helper.set_model_props(model, {DESCRIPTION_KEY: json.dumps(description.as_table())})
    onnx.checker.check_model(model)
    return model


def parse_policy(content: bytes) -> tuple[Network, Description]:
    """Return the network and the description in an ONNX file: the inverse of :func:`as_onnx`.

    No operator of the file is run: its graph has to be the one that :func:`as_onnx` writes, and its numbers then are
    all that the network needs.

    Raises:
        UnreadableError: it is another file, its numbers are not finite, or its description has a fault.
    """
    model = onnx.ModelProto()
    try:
        model.ParseFromString(content)
        properties = {item.key: item.value for item in model.metadata_props}
        numbers = {item.name: _array(item) for item in model.graph.initializer}
    except Exception as error:  # protobuf has several classes for what it raises
        raise _unreadable(f"no ONNX model of a policy ({text_of(error)})") from error
    if not model.graph.node:
        raise _unreadable("no ONNX model of a policy")
    layers = sum(node.op_type == "Gemm" for node in model.graph.node)
    if model.functions or model.graph.sparse_initializer or list(model.graph.node) != _nodes(layers):
        raise _unreadable("an ONNX model with other operators than those of a policy")
    if DESCRIPTION_KEY not in properties:
        raise _unreadable("an ONNX model without a description")
    try:
        findings = Findings()
        table = cast("dict[str, Any]", dict(parse_json(properties[DESCRIPTION_KEY])))
        description = read_table(Description, table, findings, "its table", FORMAT)
        findings.raise_errors()
    except (InputError, TypeError, ValueError) as error:
        raise _unreadable(f"a description with a fault: {error}") from error
    return _network(numbers, layers), description


def _unreadable(got: str) -> UnreadableError:
    return UnreadableError("a policy", got)


def _array(tensor: onnx.TensorProto) -> NDArray[np.float32]:
    """Return the numbers of an initializer that stand in the file itself."""
    if tensor.data_type != TensorProto.FLOAT or tensor.data_location != TensorProto.DEFAULT:
        raise ValueError(f"{tensor.name}: other numbers than float32 of this file")
    return np.frombuffer(tensor.raw_data, dtype="<f4").reshape(tuple(tensor.dims))


def _network(numbers: dict[str, NDArray[np.float32]], layers: int) -> Network:
    """Return a network of initializers, whose shapes fit and whose numbers are finite."""
    names = [f"{kind}_{i}" for i in range(layers) for kind in ("weight", "bias")]
    if set(numbers) != {"mean", "scale", "low", "high", *names} or not layers:
        raise _unreadable(f"an ONNX model with the numbers {', '.join(sorted(numbers))[:150]}")
    if bad := [name for name, values in numbers.items() if not np.isfinite(values).all()]:
        raise _unreadable(f"numbers that are not finite in {', '.join(bad)}")
    weights, biases = (tuple(numbers[f"{kind}_{i}"] for i in range(layers)) for kind in ("weight", "bias"))
    sizes = [numbers["mean"].size, *(bias.size for bias in biases)]
    shapes: dict[str, tuple[int, ...]] = {"mean": (sizes[0],), "scale": (sizes[0],)}
    for i, (inputs, outputs) in enumerate(pairwise(sizes)):
        shapes |= {f"weight_{i}": (inputs, outputs), f"bias_{i}": (outputs,)}
    if bad := [name for name, shape in shapes.items() if numbers[name].shape != shape]:
        raise _unreadable(f"numbers of other shapes than those of a network in {', '.join(bad)}")
    clip = numbers["high"]
    if clip.size != 1 or not clip.item() > 0 or not np.array_equal(numbers["low"], -clip):
        raise _unreadable("bounds of an observation that are not those of a policy")
    return Network(numbers["mean"], numbers["scale"], clip.item(), weights, biases)


def _numbers(network: Network) -> dict[str, NDArray[Any]]:
    limit = np.float32(network.clip)
    numbers: dict[str, NDArray[Any]] = {
        "mean": network.mean, "scale": network.scale, "low": np.array(-limit), "high": np.array(limit)
    }  # fmt: skip
    for i, (weight, bias) in enumerate(zip(network.weights, network.biases, strict=True)):
        numbers |= {f"weight_{i}": weight, f"bias_{i}": bias}
    return {name: np.ascontiguousarray(value) for name, value in numbers.items()}


def _nodes(layers: int) -> list[onnx.NodeProto]:
    nodes = [
        helper.make_node("Sub", [INPUT, "mean"], ["centred"]),
        helper.make_node("Mul", ["centred", "scale"], ["scaled"]),
        helper.make_node("Clip", ["scaled", "low", "high"], ["x_0"]),
    ]
    for i in range(layers):
        bend, out = ("Tanh", OUTPUT) if i == layers - 1 else ("Relu", f"x_{i + 1}")
        nodes.append(helper.make_node("Gemm", [f"x_{i}", f"weight_{i}", f"bias_{i}"], [f"sum_{i}"]))
        nodes.append(helper.make_node(bend, [f"sum_{i}"], [out]))
    return nodes
