"""Edit the text of an MJCF file in small, readable steps.

Hypotheses are edits of the user's own XML, so what is fitted and what is written back are one and the same text.
`MjSpec.to_xml` would drop comments, cut numbers to six digits and turn a dcmotor into raw arrays.
"""

from __future__ import annotations

import copy
import math
import posixpath
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Sequence
from xml.parsers import expat

import mujoco
import numpy as np

from dipc_gym.mjcf.defaults import effective
from dipc_gym.mjcf.model import FOLLOWS, INPUTS, PASSIVE, PREFIX
from dipc_gym.mjcf.scan import MjcfError
from dipc_gym.mjcf.source import Source

# What MuJoCo takes for options that are not written.
_OPTIONS = {
    "timestep": "0.002",
    "integrator": "Euler",
    "gravity": "0 0 -9.81",
    "iterations": "100",
    "noslip_iterations": "0",
}
_TAG = re.compile(rb"""<[^>"']*(?:"[^"]*"[^>"']*|'[^']*'[^>"']*)*>""")
_WRITTEN = re.compile(r"<!--.*?-->|<[^!?/>][^>]*>", re.DOTALL)  # as ElementTree writes them


class Document:
    """An MJCF tree with its includes put in place, and the edits that effects need.

    Args:
        source: a scanned model.

    Attributes:
        simulated: whether MuJoCo itself is modelled, and not a rig: dry friction is as soft as it is there.
    """

    def __init__(self, source: Source) -> None:
        self.source, self.simulated = source, False
        self._layout: dict[str, str] = {}  # start tag as ElementTree writes it -> as its author did
        self.root, self.head, self.tail = self._parse(source.text)
        self._inline(self.root)

    def copy(self) -> Document:
        """A copy to edit."""
        twin = copy.copy(self)
        twin.root = copy.deepcopy(self.root)
        return twin

    def of_a_simulation(self) -> Document:
        """A copy for recordings that MuJoCo made."""
        twin = self.copy()
        twin.simulated = True
        return twin

    def _parse(self, text: str) -> tuple[ET.Element, str, str]:
        """The tree of an XML text, and what stands before and after it."""
        root = ET.fromstring(text, ET.XMLParser(target=ET.TreeBuilder(insert_comments=True)))
        data, places = text.encode(), expat.ParserCreate("utf-8")
        first, last = [], [0]

        def start(tag: str, attributes: dict[str, str]) -> None:
            first.append(places.CurrentByteIndex)
            written = _TAG.match(data, first[-1])
            alone = ET.tostring(ET.Element(tag, attributes), encoding="unicode").removesuffix(" />")
            if written:
                self._layout.setdefault(alone, written[0].decode().rstrip("/> \n\t"))

        def end(_: str) -> None:
            last[0] = places.CurrentByteIndex

        places.StartElementHandler, places.EndElementHandler = start, end
        places.Parse(data, True)
        return root, data[: first[0]].decode(), data[data.index(b">", last[0]) + 1 :].decode()

    def _inline(self, parent: ET.Element) -> None:
        for child in list(parent):
            if child.tag != "include":
                self._inline(child)
                continue
            name = posixpath.normpath(child.get("file", "").replace("\\", "/"))
            included, _, _ = self._parse(self.source.files[name].decode("utf-8-sig"))
            self._inline(included)
            where = list(parent).index(child)
            parent.remove(child)
            for k, element in enumerate(included):
                parent.insert(where + k, element)
            if len(included):
                included[-1].tail = child.tail

    # ------------------------------------------------------------------------------------------------- finding

    def joint(self, name: str) -> ET.Element:
        """The joint of that name."""
        return self._named(self.root.iterfind(".//worldbody//joint"), "joint", name)

    def actuator(self, name: str) -> ET.Element:
        """The actuator of that name."""
        return self._named(self.root.iterfind("actuator/*"), "actuator", name)

    def sensor(self, name: str) -> ET.Element:
        """The sensor of that name."""
        return self._named(self.root.iterfind("sensor/*"), "sensor", name)

    def body(self, name: str) -> ET.Element:
        """The body of that name."""
        return self._named(self.root.iterfind(".//worldbody//body"), "body", name)

    def parent(self, element: ET.Element) -> ET.Element:
        """The element that holds another."""
        return next(p for p in self.root.iter() if any(child is element for child in p))

    def joint_names(self) -> list[str]:
        """Joints that stand in the text under a name."""
        return [name for e in self.root.iterfind(".//worldbody//joint") if (name := e.get("name"))]

    def actuator_names(self) -> list[str]:
        """Actuators that stand in the text under a name."""
        return [name for e in self.root.iterfind("actuator/*") if (name := e.get("name"))]

    def check_written_out(self, model: mujoco.MjModel) -> None:
        """Refuse a text that does not hold the joints and actuators of its model, so that none of them can be edited.

        Raises:
            MjcfError: one is made by `<replicate>` or `<attach>`.
        """
        for kind, count, there in (
            ("joint", model.njnt, self.joint_names()),
            ("actuator", model.nactuator, self.actuator_names()),
        ):
            made = [name for k in range(count) if (name := getattr(model, kind)(k).name) and name not in there]
            if made:
                out = f"spec = mujoco.MjSpec.from_file({self.source.name!r}); spec.compile(); print(spec.to_xml())"
                raise MjcfError(
                    f"{self.source.name}: no {kind} named {made[0]!r} stands in the text; <replicate> or <attach> "
                    f"makes it, so that no physics could be written there. Write the model out: `{out}`"
                )

    def _named(self, elements: Iterator[ET.Element] | Iterable[ET.Element], kind: str, name: str) -> ET.Element:
        for element in elements:
            if element.get("name") == name:
                return element
        raise MjcfError(f"{self.source.name}: no {kind} named {name!r} stands in the text")

    def effective(self, element: ET.Element, attribute: str, default: str = "") -> str:
        """An attribute of an element: its own, or what the file's default classes give it."""
        return effective(self.root, element, attribute, default)

    def limits(self, element: ET.Element, of: str) -> tuple[float, float] | None:
        """The range that holds for what an element limits, such as `ctrl` or `force`; None without one."""
        found = self.effective(element, f"{of}range").split()
        if len(found) != 2 or self.effective(element, f"{of}limited", "auto") == "false":
            return None
        low, high = map(float, found)
        return low, high

    def fresh(self, name: str) -> str:
        """The name, or one like it if something in the file has it already."""
        taken, candidate = {element.get("name") for element in self.root.iter()}, name
        k = 2
        while candidate in taken:
            candidate, k = f"{name}_{k}", k + 1
        return candidate

    def get_option(self, name: str) -> str:
        """An attribute of `<option>`, or MuJoCo's default for it; of several sections the last one holds."""
        found = [o.attrib[name] for o in self.root.iterfind("option") if name in o.attrib]
        return found[-1] if found else _OPTIONS[name]

    @property
    def timestep(self) -> float:
        """The model's time step, s."""
        return float(self.get_option("timestep"))

    def is_hinge(self, joint: ET.Element) -> bool:
        """Whether a joint turns; see `mjcf.is_hinge`."""
        return self.effective(joint, "type", "hinge") == "hinge"

    def angle(self, joint: ET.Element, radians: float) -> float:
        """A position of a joint as this file writes it: in degrees for hinges, unless the compiler says radian."""
        said = [c.attrib["angle"] for c in self.root.iterfind("compiler") if "angle" in c.attrib]
        in_degrees = not said or said[-1] == "degree"  # of several the last one holds
        return math.degrees(radians) if self.is_hinge(joint) and in_degrees else radians

    # ------------------------------------------------------------------------------------------------- editing

    def section(self, tag: str) -> ET.Element:
        """A top-level section such as `actuator`, made if it is not there."""
        found = self.root.findall(tag)
        if found:
            return found[-1]
        self._indent_last(self.root, "  ")
        made = ET.SubElement(self.root, tag)
        made.tail = "\n"
        return made

    def add(self, section: str | ET.Element, tag: str, **attributes: str | float | Sequence[float]) -> ET.Element:
        """Append an element; an attribute whose name is a Python keyword takes a trailing underscore."""
        parent = self.section(section) if isinstance(section, str) else section
        inner = "    " if parent in list(self.root) else "  " * (self._depth(parent) + 1)
        if len(parent) == 0:
            parent.text = "\n" + inner
        else:
            parent[-1].tail = "\n" + inner
        element = ET.SubElement(parent, tag)
        element.tail = "\n" + inner[:-2]
        self.set(element, **attributes)
        return element

    def set(self, element: ET.Element, **attributes: str | float | Sequence[float]) -> None:
        """Write attributes, numbers to their last digit."""
        for name, value in attributes.items():
            element.set(name.rstrip("_"), text(value))

    def plain(self, element: ET.Element, **attributes: str) -> None:
        """Write attributes that hold by default, but only where a default class of the file says otherwise."""
        for name, value in attributes.items():
            if self.effective(element, name, value) != value:
                self.set(element, **{name: value})

    def option(self, **attributes: str | float) -> None:
        """Set attributes of `<option>`."""
        found = self.root.findall("option")
        if not found:
            found = [ET.Element("option")]
            found[0].tail = "\n  "
            self.root.insert(0, found[0])
        self.set(found[-1], **attributes)

    def at_least(self, **attributes: float) -> None:
        """Raise attributes of `<option>` to at least these values."""
        for name, value in attributes.items():
            if float(self.get_option(name)) < value:
                self.option(**{name: value})

    def custom(self, effect: str, at: str, data: Sequence[float]) -> None:
        """Write what MJCF cannot say, for the loader in `dipc_gym.physics`; an entry that is there gets this data."""
        name = f"{PREFIX}:{effect}:{at}"
        for entry in self.root.iterfind("custom/numeric"):
            if entry.get("name") == name:
                entry.attrib.pop("size", None)
                self.set(entry, data=list(data))
                return
        self.add("custom", "numeric", name=name, data=list(data))

    def remembering(self, effect: str, at: str, data: Sequence[float]) -> None:
        """Write what MJCF cannot say and what depends on what went before, with room for the number it remembers."""
        before = len(self.root.findall("custom/numeric"))
        self.custom(effect, at, data)
        if len(self.root.findall("custom/numeric")) > before:
            found = [size for size in self.root.iterfind("size") if size.get("nuserdata")]
            room = int(found[-1].get("nuserdata", "0")) if found else 0
            self.set(found[-1] if found else self.section("size"), nuserdata=max(room, 0) + 1)

    def depends(self, effect: str, at: str, inputs: Sequence[str]) -> None:
        """Say what a law that the loader applies depends on: `position cart`, `velocity pole1` or `command motor`."""
        for k, said in enumerate(inputs, 1):
            name = f"{INPUTS}{k}:{effect}:{at}"
            entry = next((e for e in self.root.iterfind("custom/text") if e.get("name") == name), None)
            if entry is None:
                self.add("custom", "text", name=name, data=said)
            else:
                self.set(entry, data=said)

    def follows(self, joint: str, leader: str) -> None:
        """Say that an unseen joint starts where another one is."""
        self.add("custom", "text", name=FOLLOWS + joint, data=leader)

    def in_keyframes(self, own: ET.Element, other: ET.Element) -> None:
        """Let a joint that was added be where another one is in the file's keyframes, which list joints in order."""
        keys = [key for key in self.root.iterfind("keyframe/key") if key.get("qpos") or key.get("qvel")]
        if not keys:
            return
        joints = [joint for world in self.root.iterfind("worldbody") for joint in _in_order(world)]
        own_at = joints.index(own)
        joints.remove(own)
        other_at = joints.index(other)
        for attribute, free, ball in (("qpos", 7, 4), ("qvel", 6, 3)):
            sizes = {"free": free, "ball": ball}
            wide = [free if e.tag == "freejoint" else sizes.get(self.effective(e, "type", "hinge"), 1) for e in joints]
            for key in keys:
                values = key.get(attribute, "").split()
                if len(values) != sum(wide):  # MuJoCo says what is wrong with it
                    continue
                values.insert(sum(wide[:own_at]), values[sum(wide[:other_at])])
                self.set(key, **{attribute: " ".join(values)})

    def add_inertial(self, element: ET.Element, model: mujoco.MjModel, number: int) -> ET.Element:
        """Put an `<inertial>` with a compiled body's mass and inertia first into that body's element."""
        body = model.body(number)
        place = {"pos": list(body.ipos), "quat": list(body.iquat)}
        made = self.add(element, "inertial", **place, mass=float(body.mass[0]), diaginertia=list(body.inertia))
        element.remove(made)
        element.insert(0, made)
        return made

    def comment(self, *lines: str) -> None:
        """Put a comment at the top of the file."""
        words = "\n       ".join(re.sub("-(?=-)", "- ", line) for line in lines)
        note = ET.Comment(f" {words} ")
        note.tail = "\n  "
        self.root.insert(0, note)

    def passive(self, actuator: str) -> None:
        """Say that an actuator is a passive element, whose control nobody commands."""
        self.add("custom", "text", name=PASSIVE + actuator, data="no command")

    def text(self) -> str:
        """The whole file; tags that nobody changed look as their author wrote them."""

        def written(found: re.Match[str]) -> str:
            tag = found[0]
            if tag.startswith("<!"):
                return tag
            alone, end = (tag[:-3], "/>") if tag.endswith(" />") else (tag[:-1], ">")
            return self._layout.get(alone, alone) + end

        return self.head + _WRITTEN.sub(written, ET.tostring(self.root, encoding="unicode")) + self.tail

    def _depth(self, element: ET.Element) -> int:
        depth, here = 0, element
        while here is not self.root:
            here, depth = self.parent(here), depth + 1
        return depth

    @staticmethod
    def _indent_last(parent: ET.Element, space: str) -> None:
        if len(parent):
            parent[-1].tail = "\n" + space


def _in_order(body: ET.Element) -> Iterator[ET.Element]:
    """Joints of a body and what it carries, as MuJoCo lists them: a body's own first, wherever they stand in it."""
    inside = [*_directly(body)]
    yield from (e for e in inside if e.tag != "body")
    for child in inside:
        if child.tag == "body":
            yield from _in_order(child)


def _directly(body: ET.Element, *tags: str) -> Iterator[ET.Element]:
    """Joints and bodies in a body, or what has another tag, those in its frames too."""
    for e in body:
        if e.tag == "frame":
            yield from _directly(e, *tags)
        elif e.tag in (tags or ("joint", "freejoint", "body")):
            yield e


def written_out(source: Source, model: mujoco.MjModel) -> Source:
    """The same model with what the compiler makes up standing in its text, so that an edit of it is one of the model.

    Bodies that move get a name, that of their joint; `springdamper` becomes the stiffness and damping that it comes to,
    which would pass over any others; an `<inertial>` that geoms stand for is taken out, and one within a `<frame>`
    stands in its body.

    Args:
        source: the model.
        model: the same, compiled.
    """
    document = Document(source)
    compilers = [c for c in document.root.iterfind("compiler") if "inertiafromgeom" in c.attrib]
    changed = by_geoms = bool(compilers) and compilers[-1].get("inertiafromgeom") == "true"
    names = {body.get("name") for body in document.root.iterfind(".//worldbody//body")}
    for body in document.root.iterfind(".//worldbody//body"):
        joints = [joint for joint in _directly(body, "joint") if joint.get("name")]
        inertials = [*_directly(body, "inertial")]
        framed = bool(joints) and any(inertial not in list(body) for inertial in inertials)
        for inertial in inertials if by_geoms or framed else []:
            document.parent(inertial).remove(inertial)
            changed = True
        if not joints:
            continue
        first = str(joints[0].get("name"))
        of = model.body(int(model.joint(first).bodyid[0]))
        if not body.get("name"):
            body.set("name", document.fresh(first) if first in names else first)
            changed = True
        if framed and not by_geoms:
            document.add_inertial(body, model, of.id)
        for joint in joints:
            if any(float(word) for word in document.effective(joint, "springdamper", "0 0").split()):
                own = model.joint(joint.get("name"))
                stiffness, damping = (float(np.ravel(number)[0]) for number in (own.stiffness, own.damping))
                document.set(joint, springdamper="0 0", stiffness=stiffness, damping=damping)
                changed = True
    if not changed:
        return source
    for compiler in compilers if by_geoms else []:
        document.set(compiler, inertiafromgeom="auto")
    return source.edited(document.text())


def text(value: str | float | Sequence[float]) -> str:
    """An attribute's text; numbers keep every digit."""
    if isinstance(value, str):
        return value
    # Tables hold hundreds of them, and a diagnosis writes tens of thousands of tables.
    numbers = (value,) if isinstance(value, (int, float)) else value
    return " ".join([repr(number).removesuffix(".0") for number in map(float, numbers)])
