"""What the default classes of an MJCF file give an element."""

from __future__ import annotations

import xml.etree.ElementTree as ET

# The elements that share one default.
_ACTUATORS = frozenset(
    [
        "general",
        "motor",
        "position",
        "velocity",
        "intvelocity",
        "damper",
        "cylinder",
        "muscle",
        "adhesion",
        "dcmotor",
        "pid",
        "plugin",
    ]
)
# What stands for all of these numbers: it sets the others by a rule of its own.
_GENERAL = frozenset(["general", "plugin"])
_IN_GENERAL = frozenset(["gaintype", "biastype", "dyntype", "gainprm", "biasprm", "dynprm", "actdim"])
_TENDONS = frozenset(["fixed", "spatial", "tendon"])


def effective(root: ET.Element, element: ET.Element, attribute: str, default: str = "") -> str:
    """An attribute of an element of a model's tree: its own, or what the default classes give it.

    Of a gain, a bias and dynamics that a shortcut such as `<position kp="9"/>` in a default class gives, nothing is
    told: it is empty.
    """
    if attribute in element.attrib:
        return element.attrib[attribute]
    if root.find("default") is None:  # most files; a parent of every element is asked for below
        return default
    tags = next((shared for shared in (_ACTUATORS, _TENDONS) if element.tag in shared), {element.tag})
    for defaults in _classes(root, element):
        for entry in reversed(defaults):
            if entry.tag in tags and attribute in entry.attrib:
                return entry.attrib[attribute]
            if tags is _ACTUATORS and attribute in _IN_GENERAL and entry.tag in _ACTUATORS - _GENERAL:
                return ""
    return default


def _classes(root: ET.Element, element: ET.Element) -> list[ET.Element]:
    """The default classes that hold for an element, the nearest first."""
    parents = {child: parent for parent in root.iter() for child in parent}
    name, here = element.get("class"), element
    while name is None and here is not root:
        here = parents[here]
        name = here.get("childclass")
    chain = [d for d in root.iter("default") if name is not None and d.get("class") == name][:1]
    while chain and (above := parents[chain[-1]]) is not root:
        chain.append(above)
    return chain + [d for d in reversed(root.findall("default")) if d not in chain]
