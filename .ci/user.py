"""What a user writes, outside the checkout: type checkers find all of the installed package, and know its types."""

from typing import assert_type

import gymnasium

from dipc_gym.compensators import Compensator, StaticGain, load
from dipc_gym.controllers import LQR
from dipc_gym.runs import Course, balance, identify
from dipc_gym.wrappers import ForceCommand

gain = StaticGain(newtons_per_volt=4.0)
assert_type(gain.voltage(10.0, 0.0), float)
assert_type(identify().fit("llnf"), Compensator)
assert_type(load("llnf.json"), Compensator)

env = ForceCommand(gymnasium.make("DIPC-Friction-v0"), gain)
assert_type(env.force_limit, float)
assert_type(env.compensator, Compensator)
assert_type(balance(LQR(), gain, seconds=1.0, seed=0), Course)
