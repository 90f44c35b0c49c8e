"""A program as an ONNX graph."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from dipc_gym.dataflow import BINARY, Program, Step

OPSET = 18
"""Of ONNX Runtime 1.14, of 2023, and later."""
NAMES = {
    "add": "Add", "subtract": "Sub", "multiply": "Mul", "divide": "Div", "exp": "Exp", "tanh": "Tanh",
    "sigmoid": "Sigmoid", "join": "Concat",
}  # fmt: skip


def graph(program: Program, *, about: str) -> bytes:
    """The graph in double precision, as an `.onnx` file holds it.

    Its inputs are the program's, of shape (1,), and `state`; its outputs the program's and `next_state`. Feed
    `next_state` back as `state`; what it is at first stands in the file's metadata as `first_state`.

    Args:
        program: what to write.
        about: a description that is kept in the file.

    Raises:
        ImportError: onnx is not installed.
    """
    try:
        import onnx
        from onnx import TensorProto, helper, numpy_helper
    except ImportError as missing:
        raise ImportError("writing ONNX needs onnx: add its extra: pip install '.[onnx]' in a clone") from missing

    writer = _Writer(program, helper, numpy_helper, TensorProto)
    states = [program.steps[place] for place in program.states.values()]
    size = sum(state.size for state in states)
    nodes = writer.nodes()
    tensor = helper.make_tensor_value_info
    inputs = [tensor(name, TensorProto.DOUBLE, [1]) for name in program.inputs]
    outputs = [tensor(name, TensorProto.DOUBLE, [program.steps[place].size]) for name, place in program.outputs.items()]
    body = helper.make_graph(
        nodes,
        "control_loop",
        [*inputs, tensor("state", TensorProto.DOUBLE, [size])],
        [*outputs, tensor("next_state", TensorProto.DOUBLE, [size])],
        writer.tables,
    )
    model = helper.make_model(body, opset_imports=[helper.make_opsetid("", OPSET)], doc_string=about)
    model.ir_version = 8  # of the same year as the operators
    helper.set_model_props(model, {"first_state": " ".join(repr(x) for x in first_state(program).tolist())})
    onnx.checker.check_model(model, full_check=True)
    return bytes(model.SerializeToString())


def first_state(program: Program) -> np.ndarray:
    """What goes into `state` after a reset, (n,)."""
    return np.concatenate([program.steps[place].numbers for place in program.states.values()])


class _Writer:
    """Writes one node, or a few, for every step."""

    def __init__(self, program: Program, helper: Any, numpy_helper: Any, types: Any) -> None:
        self.program, self.helper, self.numpy_helper, self.types = program, helper, numpy_helper, types
        self.tables: list[Any] = []
        self.list: list[Any] = []

    def nodes(self) -> list[Any]:
        program, start = self.program, 0
        for place, step in enumerate(program.steps):
            if step.operation == "state":
                self._slice("state", start, step.size, f"v{place}")
                start += step.size
            elif step.operation == "input":
                self._node("Identity", [step.name], f"v{place}")
            elif step.operation != "comment":
                self._step(place, step)
        ahead = [f"v{program.updates.get(place, place)}" for place in program.states.values()]
        self._node("Concat", ahead, "next_state", axis=0)
        for name, place in program.outputs.items():
            self._node("Identity", [f"v{place}"], name)
        return self.list

    def _step(self, place: int, step: Step) -> None:
        name, operands = f"v{place}", [f"v{operand}" for operand in step.operands]
        match step.operation:
            case "constant":
                self._table(name, step.numbers)
            case "minimum" | "maximum":
                self._node("Less" if step.operation == "minimum" else "Greater", operands, f"{name}_first")
                self._node("Where", [f"{name}_first", *operands], name)
            case "less":
                self._node("Less", operands, f"{name}_is")
                self._node("Cast", [f"{name}_is"], name, to=self.types.DOUBLE)
            case "within":
                self._node("Less", operands, f"{name}_above")
                self._node("Neg", operands[1:], f"{name}_low")
                self._node("Less", [f"{name}_low", operands[0]], f"{name}_below")
                self._node("And", [f"{name}_above", f"{name}_below"], f"{name}_is")
                self._node("Cast", [f"{name}_is"], name, to=self.types.DOUBLE)
            case "choose":
                self._table(f"{name}_half", np.array([0.5]))
                self._node("Greater", [operands[0], f"{name}_half"], f"{name}_is")
                self._node("Where", [f"{name}_is", *operands[1:]], name)
            case "total" | "least":
                kind = "ReduceSum" if step.operation == "total" else "ReduceMin"
                self._node(kind, operands, name, keepdims=1)
            case "part":
                self._slice(operands[0], step.start, step.size, name)
            case "pick":
                self._gather(operands[0], step.places, name)
            case "product":
                self._product(operands, step, name)
            case "affine":
                self._table(f"{name}_weights", step.weights)
                self._table(f"{name}_biases", step.numbers)
                self._node("MatMul", [f"{name}_weights", *operands], f"{name}_product")
                self._node("Add", [f"{name}_product", f"{name}_biases"], name)
            case "join":
                self._node("Concat", operands, name, axis=0)
            case operation:
                assert operation in NAMES, (operation, BINARY)
                self._node(NAMES[operation], operands, name)

    def _product(self, operands: list[str], step: Step, name: str) -> None:
        """Vectors become matrices for it."""
        for source, shape, which in zip(
            operands, ([-1, step.inner], [step.inner, -1]), ("first", "second"), strict=True
        ):
            self._table(f"{name}_{which}_shape", np.array(shape, dtype=np.int64))
            self._node("Reshape", [source, f"{name}_{which}_shape"], f"{name}_{which}")
        self._node("MatMul", [f"{name}_first", f"{name}_second"], f"{name}_matrix")
        self._table(f"{name}_shape", np.array([-1], dtype=np.int64))
        flat = f"{name}_flat" if step.half else name
        self._node("Reshape", [f"{name}_matrix", f"{name}_shape"], flat)
        if step.half:
            rows = self.program.steps[step.operands[0]].size // step.inner
            self._gather(flat, [rows * i + j for i in range(rows) for j in range(i + 1)], name)

    def _gather(self, source: str, places: Sequence[int], name: str) -> None:
        self._table(f"{name}_places", np.array(places, dtype=np.int64))
        self._node("Gather", [source, f"{name}_places"], name)

    def _node(self, kind: str, inputs: list[str], output: str, **attributes: Any) -> None:
        self.list.append(self.helper.make_node(kind, inputs, [output], **attributes))

    def _table(self, name: str, numbers: np.ndarray) -> None:
        self.tables.append(self.numpy_helper.from_array(np.ascontiguousarray(numbers), name))

    def _slice(self, source: str, start: int, size: int, name: str) -> None:
        self._table(f"{name}_start", np.array([start], dtype=np.int64))
        self._table(f"{name}_end", np.array([start + size], dtype=np.int64))
        self._node("Slice", [source, f"{name}_start", f"{name}_end"], name)
