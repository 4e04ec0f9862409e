"""Writes a policy as an ONNX file: normalisation, layers and a description; no code is in it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from skincal.files import whole_file
from skincal.train.network import Network
from skincal.train.policy_file import DESCRIPTION_KEY, INPUT, OUTPUT, Description

OPSET: Final = 17
IR_VERSION: Final = 8


def write_policy(
    network: Network, description: Description, path: str | Path, *, force: bool = False
) -> None:
    """Writes a policy file; it appears whole or not at all.

    Args:
        network: what it computes.
        description: what it is for.
        path: where.
        force: whether a file there is replaced.
    """
    content = as_onnx(network, description).SerializeToString()
    with whole_file(path, force=force) as temporary:
        temporary.write_bytes(content)


def as_onnx(network: Network, description: Description) -> onnx.ModelProto:
    """The graph: subtract, scale, clip, then a matrix product, a sum and a bend for every layer."""
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
        last = i == layers - 1
        nodes += [
            helper.make_node("Gemm", [f"x_{i}", f"weight_{i}", f"bias_{i}"], [f"sum_{i}"]),
            helper.make_node("Tanh" if last else "Relu", [f"sum_{i}"], [OUTPUT if last else f"x_{i + 1}"]),
        ]
    return nodes
