"""A double inverted pendulum on a cart with stick-slip friction.

Importing this package registers two environments with Gymnasium: `DIPC-Friction-v0`, which is to be balanced, and
`DIPC-Friction-SwingUp-v0`, which goes from one equilibrium to another.
"""

import gymnasium

__all__ = ["ENV_ID", "SWING_UP_ID", "__version__"]

__version__ = "0.1.0"

ENV_ID = "DIPC-Friction-v0"
SWING_UP_ID = "DIPC-Friction-SwingUp-v0"

gymnasium.register(
    id=ENV_ID,
    entry_point="dipc_gym.env:DoublePendulumEnv",
    vector_entry_point="dipc_gym.vector:DIPCFrictionVectorEnv",
    max_episode_steps=2_000,
)
gymnasium.register(
    id=SWING_UP_ID,
    entry_point="dipc_gym.swing_up:SwingUpEnv",
    vector_entry_point="dipc_gym.swing_up:SwingUpVectorEnv",
    max_episode_steps=2_000,
)
