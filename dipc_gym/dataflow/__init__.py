"""What a control loop computes once a period, as a short list of vector operations with a memory.

Every part of a loop (estimator, controller, compensator) writes its own formula into a `Program`, once. From there it
is run in NumPy, written as C, or written as an ONNX graph, with the same operations in the same order.
"""

from dipc_gym.dataflow.operations import BINARY, ELEMENTWISE, REDUCTIONS, UNARY, Floats, Step
from dipc_gym.dataflow.program import NoForm, Program, Value

__all__ = ["BINARY", "ELEMENTWISE", "REDUCTIONS", "UNARY", "Floats", "NoForm", "Program", "Step", "Value"]
