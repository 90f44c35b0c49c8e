"""Hinge-and-slide models as machine code: many windows, many variants, exact sensitivities.

`rigid` is the mechanics of a tree, written once for numbers and for code; `values` writes code; `machine` compiles and
keeps it; `kernel` is the mechanics of one tree as code; `loop` steps any tree through time; `program` reads a compiled
`mjModel`, with its `constraints`; `check` compares with MuJoCo.
"""

from dipc_gym.engine.uncovered import Uncovered

__all__ = ["Uncovered"]
