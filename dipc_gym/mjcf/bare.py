"""A model without what is only looked at: its meshes and textures take a second to compile, its motion a microsecond.

A fit compiles its model thousands of times. What moves is said by `<inertial>`s, in full; geoms, and all that they are
made of, say no more where nothing touches.
"""

from __future__ import annotations

import weakref
from dataclasses import replace

import mujoco
import numpy as np

from dipc_gym.mjcf.edit import Document
from dipc_gym.mjcf.scan import MjcfError
from dipc_gym.mjcf.source import compile

HEAVY = ("mesh", "hfield", "texture")  # assets that take long to compile
SECTIONS = ("asset", "visual", "contact")  # that nothing else asks for where there are no geoms
# Groups of numbers that say how a model moves and what its sensors read, less those of geoms, and what puts to sleep.
MOVES = ("body_", "jnt_", "dof_", "tendon_", "wrap_", "actuator_", "eq_", "sensor_", "key_", "site_", "qpos")
LOOKS = ("geom", "bvh", "matid", "rgba", "contype", "conaffinity", "body_margin", "group", "sameframe", "dof_length")
ROUNDING = 1e-9  # of numbers that were written and read

_known: weakref.WeakKeyDictionary[Document, Document] = weakref.WeakKeyDictionary()


def bare(document: Document, model: mujoco.MjModel) -> Document:
    """The same model without geoms and assets, to be edited and simulated in its place, or the document itself where
    that has none that take long, or moves otherwise without them.

    Args:
        document: a model whose motion meets no contact.
        model: the same, compiled; its options may differ.
    """
    found = _known.get(document)
    if found is None:
        found = _known[document] = _without_looks(document, model) or document
    return found


def _without_looks(document: Document, model: mujoco.MjModel) -> Document | None:
    """The document without geoms and assets; None where it would not be the same model, or no quicker to compile."""
    if not any(document.root.find(f"asset/{tag}") is not None for tag in HEAVY):
        return None
    light = document.copy()
    bodies = list(light.root.iterfind(".//worldbody//body"))
    if len(bodies) != model.nbody - 1:  # some are made, or fused, by the compiler
        return None
    for number, body in enumerate(bodies, 1):
        of = model.body(number)
        if body.get("name", of.name) != of.name:
            return None
        if body.find("inertial") is None and of.mass[0] > 0:
            light.add_inertial(body, model, number)
    for parent in list(light.root.iter()):
        for child in list(parent):
            if (child.tag == "geom" and parent.tag in ("worldbody", "body", "frame")) or (
                parent is light.root and child.tag in SECTIONS
            ):
                parent.remove(child)
    light.source = replace(light.source, text=light.text(), files={})
    try:
        made_of_it = compile(light.source, trusted=True)
    except MjcfError:  # something asks for a geom
        return None
    return light if _moves_alike(model, made_of_it) else None


def _moves_alike(model: mujoco.MjModel, other: mujoco.MjModel) -> bool:
    """Whether two models are the same but for what they look like."""
    if model.opt.density or model.opt.viscosity:  # a medium pushes on geoms
        return False
    for name in dir(model):
        if not name.startswith(MOVES) or any(word in name for word in LOOKS):
            continue
        ours, theirs = np.asarray(getattr(model, name)), np.asarray(getattr(other, name))
        if ours.shape != theirs.shape:
            return False
        if ours.dtype.kind in "iufb" and not np.allclose(ours, theirs, rtol=ROUNDING, atol=1e-12):
            return False
    return True
