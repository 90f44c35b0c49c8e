"""A model with what MJCF cannot say, applied around MuJoCo's step."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf
from dipc_gym.physics import custom
from dipc_gym.physics.entries import Extra, Stage
from dipc_gym.physics.formulas import SOONEST, Moment, moment

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)  # two are the same where they are one: arrays and models have no equality to go by
class Physics:
    """A compiled model with what MJCF cannot say.

    Attributes:
        model: the MuJoCo model.
        extras: effects that stock MuJoCo leaves out, in the order of the file.
        ranges: least and most of each control in each simulation of a batch, (n, nu) each; None: as the model has it.

    Example:
        >>> physics = from_model(mjcf.compile(
        ...     '<mujoco><worldbody><body><joint name="a"/><geom size="1"/></body></worldbody></mujoco>'))
        >>> data = mujoco.MjData(physics.model)
        >>> physics.step(data, np.zeros(0), 5)
        >>> round(data.time, 3)
        0.01
    """

    model: mujoco.MjModel
    extras: tuple[Extra, ...] = ()
    ranges: tuple[Array, Array] | None = None

    def stage(self, stage: Stage) -> tuple[Extra, ...]:
        """The extras that act at one stage."""
        return tuple(extra for extra in self.extras if extra.stage == stage)

    @property
    def acts(self) -> bool:
        """Whether friction or forces have to be written at each step."""
        return any(extra.stage in ("friction", "force") for extra in self.extras)

    @property
    def remembering(self) -> tuple[Extra, ...]:
        """The extras that depend on what went before, in the order of what they remember in `userdata`."""
        return tuple(extra for extra in self.extras if extra.remembers)

    @functools.cached_property
    def taken(self) -> tuple[Array, Array]:
        """Least and most of each control that its actuator takes, (..., nu) each: more of it acts nowhere."""
        return self.ranges or mjcf.command_ranges(self.model)

    @functools.cached_property
    def _passive(self) -> tuple[list[int], Array]:
        return mjcf.passive_moments(self.model)

    @property
    def pressed(self) -> bool:
        """Whether dry friction may depend on the forces at its joint, and not on where it is alone."""
        return any(extra.pressed for extra in self.extras)

    def command(self, ctrl: Array, time: Array | float = 0.0) -> Array:
        """The command that the model sees for a command (..., nu) sent to the rig."""
        changed = ctrl
        for extra in self.stage("command"):
            if changed is ctrl:
                changed = np.array(ctrl, dtype=float)
            changed[..., extra.index] = extra(moment(time, value=changed[..., extra.index]))
        return changed

    def sense(self, sensordata: Array, memory: Array | None = None, dt: float = 0.0) -> Array:
        """What the rig's sensors say where the model's say `sensordata` (..., nsensordata).

        In whatever order a file has them, a sensor lags before its scale is bent, as in the engine.

        Args:
            sensordata: the model's readings.
            memory: what `sensor_memory` returned, updated in place; None where no sensor lags.
            dt: time since the last call with this memory, s.
        """
        read = sensordata
        for extra in (*self.stage("lag"), *self.stage("sensor")):
            if read is sensordata:
                read = np.array(sensordata, dtype=float)
            i = extra.index
            if extra.stage == "sensor":
                read[..., i] = extra(moment(0.0, value=read[..., i]))
            elif memory is not None and dt > 0:
                given = read[..., i].copy()
                read[..., i] = _follow(memory[0][..., i], memory[1][..., i], given, dt, extra.data[..., 0])
                memory[0][..., i], memory[1][..., i] = given, read[..., i]
        return read

    def sensor_memory(self, sensordata: Array) -> Array | None:
        """Memory (2, ..., nsensordata) of lagging sensors at rest at these readings; None if no sensor lags."""
        return np.stack([sensordata, sensordata]) if self.stage("lag") else None

    def act(
        self, state: Any, frictionloss: Array, applied: Array, step: float = 0.0, slides: Array | None = None
    ) -> None:
        """Write friction and forces of this moment, or of a step that begins now.

        They are held over the step, so they are those of its middle: held from its beginning, a force that depends on
        time would come half a step late.

        Args:
            state: an `MjData`, a `mujoco.batch.Batch` with bound fields (n, ...), or what has such fields.
            frictionloss: where dry friction goes, (..., nv).
            applied: where generalised forces go, (..., nv).
            step: s.
            slides: 1 for each joint that is known to slide, however slowly, (..., nv); None where speeds alone tell.
        """
        pushed: set[int] = set()
        for extra in self.extras:
            if extra.stage not in ("friction", "force"):
                continue
            j, now = extra.index, self._now(extra, state, step, slides)
            if extra.stage == "friction":
                frictionloss[..., j] = extra(now)
            else:
                # What was applied in the step before still stands there, so the first one replaces it.
                applied[..., j] = extra(now) + (applied[..., j] if j in pushed else 0.0)
                pushed.add(j)

    def grown(self, state: Any, slides: Array | None = None) -> Array:
        """Rates of what entries remember, at this moment, (..., memories); see `act`."""
        rates = [extra.grows(self._now(extra, state, 0.0, slides)) for extra in self.remembering]
        return np.stack(rates, axis=-1) if rates else np.zeros(0)

    def _now(self, extra: Extra, state: Any, step: float, slides: Array | None) -> Moment:
        """What an entry looks at in the middle of a step that begins now; what it remembers goes on to its end."""
        j, time = extra.index, state.time + step / 2
        speed = state.qvel[..., j]
        q = state.qpos[..., self.model.jnt_qposadr[self.model.dof_jntid[j]]] + step / 2 * speed
        if extra.pressed:
            passive, moments = self._passive
            drive = state.qfrc_actuator[..., j] - state.actuator_force[..., passive] @ moments[:, j]
            now = moment(time, q, drive, state.qfrc_bias[..., j])
        else:
            now = moment(time, q)
        inputs = self._seen(extra, state, step) if extra.inputs else ()
        now = replace(now, speed=speed, inputs=inputs, slides=0.0 if slides is None else slides[..., j])
        if not extra.remembers:
            return now
        before = state.userdata[..., extra.slot]
        if not step:
            return replace(now, memory=before)
        now = replace(now, speed=speed + step / 2 * state.qacc[..., j])
        middle, state.userdata[..., extra.slot] = _gone_on(extra, now, before, step)
        return replace(now, memory=middle)

    def _seen(self, extra: Extra, state: mujoco.MjData, step: float) -> tuple[Array, ...]:
        """What a law depends on, two numbers; positions are those of the middle of a step that begins now."""
        seen = []
        for kind, k in extra.inputs:
            if kind == "command":
                low, high = self.taken
                seen.append(np.clip(state.ctrl[..., k], low[..., k], high[..., k]))
            elif kind == "velocity":
                seen.append(state.qvel[..., k])
            else:
                joint = int(np.flatnonzero(self.model.jnt_qposadr == k)[0])
                seen.append(state.qpos[..., k] + step / 2 * state.qvel[..., self.model.jnt_dofadr[joint]])
        return (*seen, np.zeros_like(seen[0])) if len(seen) == 1 else tuple(seen)

    def step(self, data: mujoco.MjData, ctrl: Array, nstep: int = 1) -> None:
        """Advance one simulation by `nstep` steps under a held command (nu,)."""
        data.ctrl[:] = self.command(ctrl, data.time)
        if not self.acts:
            mujoco.mj_step(self.model, data, nstep)
            return
        for _ in range(nstep):
            self.act(data, self.model.dof_frictionloss, data.qfrc_applied, self.model.opt.timestep)
            mujoco.mj_step(self.model, data)


def _gone_on(extra: Extra, now: Moment, before: Array, step: float) -> tuple[Array, Array]:
    """What an entry remembers in the middle of a step and at its end, by the midpoint rule.

    A memory may fade faster than a long step lasts, and would swing up; then it takes several.

    Args:
        extra: what remembers.
        now: the middle of the step.
        before: what it remembers at its beginning.
        step: s.
    """
    parts = max(math.ceil(step / SOONEST - 1e-9), 1)
    middle = after = np.array(before, dtype=float)
    for _ in range(parts):
        middle = after + step / parts / 2 * extra.grows(replace(now, memory=after))
        after = after + step / parts * extra.grows(replace(now, memory=middle))
    return (middle if parts == 1 else (before + after) / 2), after


def _follow(before: Array, followed: Array, after: Array, dt: float, tau: Array) -> Array:
    """A first-order lag over one interval in which its input goes straight from `before` to `after`."""
    decay = np.exp(-dt / tau)
    slope = (after - before) / dt
    return decay * followed + (after - tau * slope) - decay * (before - tau * slope)


def load(source: mjcf.Source | str | Path) -> Physics:
    """Read a model together with the physics that MJCF cannot say.

    Args:
        source: a path, MJCF text, or a scanned source.

    Raises:
        mjcf.MjcfError: the model is refused or does not compile, or an entry of `<custom>` is not understood.
    """
    source = mjcf.as_source(source)
    return from_model(mjcf.compile(source), source.name)


def from_model(model: mujoco.MjModel, name: str = "the model") -> Physics:
    """The physics of a compiled model, its `<custom>` entries included.

    Args:
        model: compiled.
        name: what messages call it, as its file.

    Raises:
        mjcf.MjcfError: an entry names an unknown effect or place, or has the wrong count of numbers.
    """
    try:
        return Physics(model, tuple(custom.read(model)))
    except mjcf.MjcfError as error:
        raise mjcf.MjcfError(f"{name}: {error}") from None


def stack(variants: Sequence[Physics], which: NDArray[np.intp]) -> Physics:
    """One physics for a batch whose simulation i follows variant `which[i]`.

    Args:
        variants: the same model and effects with different numbers.
        which: (n,) index into `variants`.

    Returns:
        Physics whose extras hold (n, k) numbers, and whose controls have the ranges of each; its model is the first
        variant's.
    """
    first = variants[0]
    extras = tuple(
        replace(extra, data=np.stack([variant.extras[i].data for variant in variants])[which])
        for i, extra in enumerate(first.extras)
    )
    low, high = (np.stack(ends)[which] for ends in zip(*(variant.taken for variant in variants), strict=True))
    return Physics(first.model, extras, (low, high))
