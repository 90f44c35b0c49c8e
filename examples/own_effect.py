"""Add physics of your own to the diagnosis: one class, one edit of the MJCF, one sentence.

This one is drag that grows with the cube of speed, which no effect of the catalogue is. MuJoCo has it already (the
third coefficient of a joint's damping), so stock MuJoCo loads what is found. `fit_effect` tries it alone, which is what
you want while you write it. Once it is registered, `dipc_gym.sim2real.diagnose` compares it with all the others in the
same program; with `effects=` it compares those alone that you list. The command line knows the catalogue only.
Run it: python examples/own_effect.py
"""

import mujoco
import numpy as np

from dipc_gym import mjcf
from dipc_gym.recording import Recorder, Recording
from dipc_gym.sim2real import Document, Effect, Evidence, Parameter, Values, catalogue, fit_effect, register

RIG = """
<mujoco model="paddle">
  <!-- A paddle in a tank, turned by a motor that gives torque. -->
  <option timestep="0.001" integrator="implicitfast" gravity="0 0 0"/>
  <worldbody>
    <body name="paddle">
      <joint name="shaft" axis="0 0 1" damping="0.02"/>
      <geom type="box" size="0.2 0.01 0.1" mass="0.5"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="shaft"/></actuator>
  <sensor><jointpos name="angle" joint="shaft"/></sensor>
</mujoco>
"""


class CubicDrag(Effect):
    """Drag in proportion to the cube of speed."""

    id = "drag.cubic"
    place = "joint"
    # The unit is that of a slide; reports say it for a hinge where there is one.
    parameters = (Parameter("coefficient", "N s^3/m^3", low=0.0),)
    rivals = ("drag.quadratic", "friction.viscous")

    def guesses(self, evidence: Evidence) -> list[Values]:
        # What part of the unexplained force goes with -v^3? At least a little: a guess of zero would show nothing.
        (coefficient,) = evidence.along(-(evidence.velocity**3))
        typical = evidence.force_scale / evidence.speed_scale**3
        return [{"coefficient": float(np.clip(coefficient, 0.05 * typical, 2 * typical))}]

    def edit(self, document: Document, at: str, values: Values) -> None:
        joint = document.joint(at)
        linear, quadratic, _ = [*document.effective(joint, "damping", "0").split(), "0", "0"][:3]
        document.set(joint, damping=[float(linear), float(quadratic), values["coefficient"]])

    def sentence(self, at: str, values: Values, unit: dict[str, str]) -> str:
        return f"Drag with the cube of speed, {values['coefficient']:.3g} {unit['coefficient']}, at {at}."


def record(text: str, seconds: float = 8.0, period: float = 0.002) -> Recording:
    """The real paddle, here a simulation in fine steps: a swept torque, and an encoder with some noise."""
    model, rng = mjcf.compile(text.replace('timestep="0.001"', 'timestep="0.0002"')), np.random.default_rng(0)
    data, recorder = mujoco.MjData(model), Recorder(["motor"], ["angle"])
    for time in np.arange(0.0, seconds, period):
        mujoco.mj_forward(model, data)
        torque = 0.3 * np.sin(2 * np.pi * (0.2 + 0.1 * time) * time)
        recorder.append(time, [torque], data.sensordata + rng.normal(scale=1e-4))
        data.ctrl[:] = torque
        mujoco.mj_step(model, data, round(period / model.opt.timestep))
    return recorder.recording("paddle")


def main() -> None:
    register(CubicDrag())
    run = record(RIG.replace('damping="0.02"', 'damping="0.02 0 0.004"'))
    for name in ("drag.quadratic", "drag.cubic"):
        (found,) = fit_effect(catalogue()[name], mjcf.from_text(RIG), [run])
        print(f"off by {found.error:.2f} times the noise, {found.error_without:.0f} without it: {found.sentence}")
    print("".join(line for line in found.improved.splitlines(keepends=True) if 'name="shaft"' in line))


if __name__ == "__main__":
    main()
