"""Add physics of your own to the diagnosis: one class, one edit of the MJCF, one sentence.

This one is drag that grows with the cube of speed, which no effect of the catalogue is. MuJoCo has it already (the
third number of a joint's damping), so stock MuJoCo loads what is found. Registered, it is tried on every recording
beside all the others, by `dipc_gym.sim2real.diagnose` too. Run it: python examples/own_effect.py
"""

import mujoco
import numpy as np

from dipc_gym import mjcf, physics
from dipc_gym.recording import Recorder
from dipc_gym.sim2real import effects
from dipc_gym.sim2real.effects import Effect, Parameter
from dipc_gym.sim2real.estimation.evidence import places, scene
from dipc_gym.sim2real.estimation.fit import fit
from dipc_gym.sim2real.estimation.segments import prepare
from dipc_gym.sim2real.model.structure import Term
from dipc_gym.sim2real.simulation.batch import Stepping

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

    def guesses(self, evidence):
        # What part of the unexplained force goes with -v^3? At least a little: a guess of zero would show nothing.
        (coefficient,) = evidence.along(-(evidence.velocity**3))
        typical = evidence.force_scale / evidence.speed_scale**3
        return [{"coefficient": float(np.clip(coefficient, 0.05 * typical, 2 * typical))}]

    def edit(self, document, at, values):
        joint = document.joint(at)
        linear, quadratic, _ = [*document.effective(joint, "damping", "0").split(), "0", "0"][:3]
        document.set(joint, damping=[float(linear), float(quadratic), values["coefficient"]])

    def sentence(self, at, values, unit):
        return f"Drag with the cube of speed, {values['coefficient']:.3g} {unit['coefficient']}, at {at}."


def record(text: str, seconds: float = 12.0):
    """The real paddle, here a simulation: a swept torque, an encoder with some noise, 500 samples a second."""
    model, rng = mjcf.compile(text), np.random.default_rng(0)
    data, recorder = mujoco.MjData(model), Recorder(["motor"], ["angle"])
    while data.time < seconds:
        mujoco.mj_forward(model, data)
        torque = 0.3 * np.sin(2 * np.pi * (0.2 + 0.1 * data.time) * data.time)
        recorder.append(data.time, [torque], data.sensordata + rng.normal(scale=1e-4))
        data.ctrl[:] = torque
        mujoco.mj_step(model, data, 2)
    return recorder.recording("paddle")


def main() -> None:
    effects.register(CubicDrag())
    run = record(RIG.replace('damping="0.02"', 'damping="0.02 0 0.004"'))

    # What `diagnose` does for every effect at every place, here for the two kinds of drag.
    source = mjcf.from_text(RIG)
    nominal = physics.load(source)
    ready = prepare(source, nominal, [run], Stepping(0.002, mujoco.mjtIntegrator.mjINT_RK4))
    problem = ready.problem.pick(np.arange(0, len(ready.problem.windows), 2))
    print(f"as it is, the model is off by {fit(problem, ready.structure).error:.1f} times the noise")
    seen = scene(nominal, [run], ready.motions, 1.0)
    for name in ("drag.quadratic", "drag.cubic"):
        effect = effects.catalogue()[name]
        for at in places(effect, nominal.model, ready.structure.base, run):
            term = Term(effect, at, effect.guesses(seen.at("joint", at, {}))[0])
            found = fit(problem, ready.structure.with_term(term))
            values = found.structure.term_values(found.z, term)
            words = effect.sentence(at, values, {"coefficient": "N m s^3" if "cubic" in name else "N m s^2"})
            print(f"off by {found.error:.1f}: {words}")
    changed = found.structure.write(found.z).text()
    print("".join(line for line in changed.splitlines(keepends=True) if 'name="shaft"' in line))


if __name__ == "__main__":
    main()
