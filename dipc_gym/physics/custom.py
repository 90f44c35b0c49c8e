"""What stands under `<custom>` of a compiled model: its entries read, placed, and refused where they cannot be."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import mujoco

from dipc_gym import mjcf
from dipc_gym.physics.entries import HEAD, Extra, Stage, entry_of, fault, known
from dipc_gym.physics.numbers import Array, Inputs
from dipc_gym.safety.naming import suggestion


def read(model: mujoco.MjModel) -> list[Extra]:
    """The entries of a compiled model, in the order of the file.

    Raises:
        mjcf.MjcfError: one names an unknown effect or place, or has numbers that it cannot have.
    """
    extras = []
    for i in range(model.nnumeric):
        name = model.numeric(i).name
        if not name.startswith(mjcf.PREFIX + ":"):
            continue
        _, effect, *places = name.split(":", 2)
        entry = entry_of(effect)
        if entry is None or not places:
            effects = sorted(each.effect for each in known())
            near = suggestion(effect, effects)
            raise mjcf.MjcfError(f"<custom> entry {name!r}: known effects are {', '.join(effects)}{near}")
        (at,) = places
        index, inputs = _index(model, name, entry.stage, at), _inputs(model, effect, at, alone=entry.alone)
        extras.append(Extra(effect, at, entry.stage, index, model.numeric(i).data.copy(), inputs))
    _one_dry_law_each(extras)
    extras = _with_slots(model, extras)
    for extra in extras:
        if (wrong := fault(extra)) is not None:
            raise mjcf.MjcfError(_refused(extra, wrong))
    return extras


def _refused(extra: Extra, wrong: str) -> str:
    """A sentence about an entry with wrong numbers: these, what is wrong, and what they should be."""
    says = (extra.entry.rule.__doc__ or "").strip().partition("\n")[0]
    return (
        f"<custom> entry '{_name(extra)}' has the numbers {_shown(extra.data)}, too few, too many or out of range"
        f"{': ' if wrong else ''}{wrong}; {says}"
    )


def _name(extra: Extra) -> str:
    return f"{mjcf.PREFIX}:{extra.effect}:{extra.at}"


def _shown(numbers: Array) -> str:
    """Numbers of an entry, the first of many."""
    more = f", and {len(numbers) - HEAD:,} more" if len(numbers) > HEAD else ""
    return f"{numbers[:HEAD].tolist()}{more}"


def _one_dry_law_each(extras: Sequence[Extra]) -> None:
    """Refuse two laws that both say how large the dry friction of one joint is.

    Raises:
        mjcf.MjcfError: there are two.
    """
    first = dict[str, str]()
    for extra in extras:
        if extra.stage == "friction" and first.setdefault(extra.at, extra.effect) != extra.effect:
            raise mjcf.MjcfError(
                f"<custom> entry '{_name(extra)}': {first[extra.at]} says how large the dry friction of {extra.at!r} "
                "is already; keep one of them"
            )


def _with_slots(model: mujoco.MjModel, extras: list[Extra]) -> list[Extra]:
    """The last numbers of MuJoCo's `userdata` are what entries remember, in their order; those before are the user's.

    Raises:
        mjcf.MjcfError: there are fewer.
    """
    remember = [extra.entry.memory is not None for extra in extras]
    first = model.nuserdata - sum(remember)
    if first < 0:
        names = " and ".join(_name(extra) for extra, does in zip(extras, remember, strict=True) if does)
        raise mjcf.MjcfError(
            f"{names} under <custom> remember what went before, and the file keeps room for {model.nuserdata} numbers; "
            f'write <size nuserdata="{sum(remember)}"/>'
        )
    slots = iter(range(first, model.nuserdata))
    return [replace(extra, slot=next(slots)) if does else extra for extra, does in zip(extras, remember, strict=True)]


def _inputs(model: mujoco.MjModel, effect: str, at: str, *, alone: bool) -> Inputs:
    """What a law depends on beyond its place, as `<text>` of `<custom>` names it."""
    texts = mjcf.texts(model)
    if alone:
        if (name := f"{mjcf.INPUTS}1:{effect}:{at}") in texts:
            raise mjcf.MjcfError(f"<custom> entry {name!r}: {effect} depends on nothing beyond its place; take it out")
        return ()
    joints = {model.joint(j).name: j for j in range(model.njnt)}
    commands = {control: k for k, control in enumerate(mjcf.controls(model))}
    found = []
    for name in (f"{mjcf.INPUTS}{k}:{effect}:{at}" for k in (1, 2)):
        if name not in texts:
            break
        kind, _, of = texts[name].partition(" ")
        there = {"position": joints, "velocity": joints, "command": commands}.get(kind)
        if there is None or of not in there:
            what = f"{', '.join(there)}{suggestion(of, there)}" if there else "position, velocity and command"
            raise mjcf.MjcfError(f"<custom> entry {name!r}: no {texts[name]!r} in the model; there are {what}")
        address = {"position": model.jnt_qposadr, "velocity": model.jnt_dofadr}.get(kind)
        found.append((kind, there[of] if address is None else int(address[there[of]])))
    return tuple(found)


def _index(model: mujoco.MjModel, name: str, stage: Stage, at: str) -> int:
    """The control, sensor address or degree of freedom that an entry names."""
    there: Mapping[str, int]
    if stage == "command":
        there = {control: i for i, control in enumerate(mjcf.controls(model))}
    elif stage in ("sensor", "lag"):
        addresses = mjcf.sensor_addresses(model)
        there = {sensor: int(a) for sensor, a in zip(mjcf.scalar_sensors(model), addresses, strict=True)}
    else:
        there = {model.joint(j).name: int(model.jnt_dofadr[j]) for j in range(model.njnt)}
    if at not in there:
        there_are = f"there are {', '.join(there)}{suggestion(at, there)}"
        raise mjcf.MjcfError(f"<custom> entry {name!r}: no {at!r} in the model; {there_are}")
    return there[at]
