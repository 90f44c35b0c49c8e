"""A double inverted pendulum on a cart with stick-slip friction.

Importing this package registers `DIPC-Friction-v0` with Gymnasium.
"""

import gymnasium

__all__ = ["ENV_ID", "__version__"]

__version__ = "0.1.0"

ENV_ID = "DIPC-Friction-v0"

gymnasium.register(
    id=ENV_ID,
    entry_point="dipc_gym.env:DoublePendulumEnv",
    vector_entry_point="dipc_gym.vector:DIPCFrictionVectorEnv",
    max_episode_steps=2_000,
)
