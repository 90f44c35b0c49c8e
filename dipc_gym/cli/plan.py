"""`dipc-gym plan`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from dipc_gym.cli.options import ending, free


@dataclass(frozen=True)
class Plan:
    """Plan a motion from one equilibrium to another, and the feedback that keeps the rig near it.

    Trajectory optimisation by CasADi and IPOPT (the extra plan), a time-varying LQR around the best motion
    that was found, and the LQR that holds the goal. Of the rig it takes what the LQR knows: the linear model about
    upright, the motor's force and the rail. It then tries the plan, from so many resets, seen through the estimator
    rigid_body and with the friction that this observes fed forward. Postures are down-down, down-up, up-down and up-up,
    first pole first.

    Try:
        dipc-gym plan --out swing_up.json
        dipc-gym plan --out over.json --start down-up --goal up-down
        dipc-gym plan --out mine.json --model improved.xml --resets 15
    """

    out: Path
    """file for the plan, which controllers.load takes"""
    start: str = "down-down"
    """equilibrium to begin at"""
    goal: str = "up-up"
    """equilibrium to reach and hold"""
    plant: str | None = None
    """JSON file of the plant; where parameters are distributions, their centres"""
    model: str | None = None
    """MJCF file of the rig: a cart, two poles and a motor"""
    seed: int = 0
    """of the first guesses, and the first of the resets"""
    resets: int = 5
    """how many to try it from, ten seconds each"""
    overwrite: bool = False
    """replace the file if it exists"""

    def run(self) -> int:
        """Plan, save and try."""
        import gymnasium

        from dipc_gym import SWING_UP_ID, runs
        from dipc_gym.controllers import lqr, trajectory
        from dipc_gym.controllers.tracking import Tracking
        from dipc_gym.mechanics.motion import Motion
        from dipc_gym.postures import checked

        checked(self.start, "--start")
        free(self.out, self.overwrite)
        ending(self.out, ".json")
        if self.resets < 0:
            raise ValueError(f"--resets {self.resets}: give the number of resets to try it from, 0 or more")
        env = gymnasium.make(SWING_UP_ID, start=self.start, goal=self.goal, plant=self.plant, model=self.model)
        inner = env.unwrapped
        plant = inner.plant  # type: ignore[attr-defined]
        if plant.motor is None:
            raise ValueError("the model's motor is not known, so its force is not, and nothing can be planned")
        motion = Motion.of(*lqr.linear_model(inner.model))  # type: ignore[attr-defined]
        limits = trajectory.Limits(plant.motor.force_per_volt * plant.supply, inner.rig.rail)  # type: ignore[attr-defined]
        planned = trajectory.plan(
            motion, limits, plant.control_period, start=self.start, goal=self.goal, seed=self.seed
        )
        env.close()
        planned.save(self.out)
        room, most = abs(planned.states[:, 0]).max(), abs(planned.forces).max()
        print(f"{self.out}: {planned.seconds:g} s, up to {most:.0f} N and {1000 * room:.0f} mm")
        if self.resets:
            found = runs.identify(self.plant, model=self.model, seed=self.seed)
            parts = found.fit("observed"), found.fit_estimator("rigid_body")
            held = 0
            for seed in range(self.seed, self.seed + self.resets):
                course = runs.swing_up(
                    Tracking.load(self.out),
                    parts[0],
                    seconds=planned.seconds + 10.0,
                    seed=seed,
                    start=self.start,
                    goal=self.goal,
                    plant=self.plant,
                    model=self.model,
                    estimator=parts[1],
                )
                held += course.held(self.goal) >= 10.0
            print(f"reached {self.goal} and held it for 10 s from {held} of {self.resets} resets")
        return 0
