"""Edit the text of an MJCF file in small, readable steps.

Hypotheses are edits of the user's own XML, so what is fitted and what is written back are one and the same text.
`MjSpec.to_xml` would drop comments, cut numbers to six digits and turn a dcmotor into raw arrays.
"""

from __future__ import annotations

import copy
import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Sequence

from dipc_gym import mjcf
from dipc_gym.physics import PREFIX

FOLLOWS = f"{PREFIX}:follows:"


class Document:
    """An MJCF tree with its includes put in place, and the edits that effects need.

    Args:
        source: a scanned model.
    """

    def __init__(self, source: mjcf.Source) -> None:
        self.source = source
        parser = ET.XMLParser(target=ET.TreeBuilder(insert_comments=True))
        self.root = ET.fromstring(source.text, parser)
        self._inline(self.root, "")

    def copy(self) -> Document:
        """A copy to edit."""
        twin = object.__new__(Document)
        twin.source, twin.root = self.source, copy.deepcopy(self.root)
        return twin

    def _inline(self, parent: ET.Element, folder: str) -> None:
        for child in list(parent):
            if child.tag != "include":
                self._inline(child, folder)
                continue
            name = folder + child.get("file", "")
            parser = ET.XMLParser(target=ET.TreeBuilder(insert_comments=True))
            included = ET.fromstring(self.source.files[name].decode(), parser)
            self._inline(included, folder)
            where = list(parent).index(child)
            parent.remove(child)
            for k, element in enumerate(included):
                parent.insert(where + k, element)

    # ------------------------------------------------------------------------------------------------- finding

    def joint(self, name: str) -> ET.Element:
        """The joint of that name."""
        return self._named(self.root.iterfind(".//worldbody//joint"), "joint", name)

    def actuator(self, name: str) -> ET.Element:
        """The actuator of that name."""
        return self._named((e for e in self.section("actuator") if isinstance(e.tag, str)), "actuator", name)

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
        section = self.root.find("actuator")
        return [name for e in (section if section is not None else []) if (name := e.get("name"))]

    def _named(self, elements: Iterator[ET.Element] | Iterable[ET.Element], kind: str, name: str) -> ET.Element:
        for element in elements:
            if element.get("name") == name:
                return element
        raise mjcf.MjcfError(f"{self.source.name}: no {kind} named {name!r} stands in the text")

    @property
    def timestep(self) -> float:
        """The model's time step, s; MuJoCo's default if it has none."""
        option = self.root.find("option")
        return float(option.get("timestep", "0.002")) if option is not None else 0.002

    def angle(self, joint: ET.Element, radians: float) -> float:
        """A position of a joint as this file writes it: in degrees for hinges, unless the compiler says radian."""
        hinge = joint.get("type", "hinge") == "hinge"
        in_degrees = all(c.get("angle", "degree") == "degree" for c in self.root.iterfind("compiler"))
        return math.degrees(radians) if hinge and in_degrees else radians

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

    def option(self, **attributes: str | float) -> None:
        """Set attributes of `<option>`."""
        found = self.root.find("option")
        if found is None:
            found = ET.Element("option")
            found.tail = "\n  "
            self.root.insert(0, found)
        self.set(found, **attributes)

    def at_least(self, **attributes: float) -> None:
        """Raise attributes of `<option>` to at least these values."""
        found = self.root.find("option")
        for name, value in attributes.items():
            if found is None or float(found.get(name, "0")) < value:
                self.option(**{name: value})

    def custom(self, effect: str, at: str, data: Sequence[float]) -> None:
        """Write what MJCF cannot say, for the loader in `dipc_gym.physics`."""
        self.add("custom", "numeric", name=f"{PREFIX}:{effect}:{at}", data=list(data))

    def follows(self, joint: str, leader: str) -> None:
        """Say that an unseen joint starts where another one is."""
        self.add("custom", "text", name=FOLLOWS + joint, data=leader)

    def comment(self, *lines: str) -> None:
        """Put a comment at the top of the file."""
        words = "\n       ".join(line.replace("--", "- -") for line in lines)
        note = ET.Comment(f" {words} ")
        note.tail = "\n  "
        self.root.insert(0, note)

    def passive(self, actuator: str) -> None:
        """Say that an actuator is a passive element, whose control nobody commands."""
        self.add("custom", "text", name=mjcf.PASSIVE + actuator, data="no command")

    def text(self) -> str:
        """The whole file."""
        return ET.tostring(self.root, encoding="unicode") + "\n"

    def _depth(self, element: ET.Element) -> int:
        depth, here = 0, element
        while here is not self.root:
            here, depth = self.parent(here), depth + 1
        return depth

    @staticmethod
    def _indent_last(parent: ET.Element, space: str) -> None:
        if len(parent):
            parent[-1].tail = "\n" + space


def text(value: str | float | Sequence[float]) -> str:
    """An attribute's text; numbers keep every digit."""
    if isinstance(value, str):
        return value
    if isinstance(value, (int, float)):
        return repr(float(value)).removesuffix(".0")
    return " ".join(text(float(number)) for number in value)
