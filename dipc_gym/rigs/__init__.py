"""Many rigs of one layout, stepped together: by MuJoCo's batch, or by machine code of the engine.

Both say the same things of a control period (`together.Rigs`); the environments know no more of them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from dipc_gym.rigs.together import Rigs
from dipc_gym.safety.naming import suggestion


def _mujoco(*args: Any, **kwargs: Any) -> Rigs:
    from dipc_gym.rigs.batch import MujocoRigs

    return MujocoRigs(*args, **kwargs)


def _compiled(*args: Any, **kwargs: Any) -> Rigs:
    from dipc_gym.rigs.compiled import CompiledRigs  # LLVM takes a while to import

    return CompiledRigs(*args, **kwargs)


ENGINES: dict[str, Callable[..., Rigs]] = {"mujoco": _mujoco, "compiled": _compiled}


def unknown_engine(name: object) -> str:
    """What to say of an engine that there is not."""
    there_are = " or ".join(map(repr, ENGINES))
    return f"engine is {name!r}; it can be {there_are}{suggestion(str(name), list(ENGINES))}"
