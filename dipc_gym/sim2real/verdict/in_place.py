"""What a found effect takes the place of: a model may hold a delay already, of another length.

Most effects are asked where the model has nothing of the kind, or its parameter is refitted. These few write over what
is there, so what is told of them is the whole, and not what was lacking.
"""

from __future__ import annotations

from collections.abc import Mapping

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.model.structure import Term
from dipc_gym.sim2real.verdict.settings import VERDICT


def in_place_of(document: Document, term: Term, values: Mapping[str, float]) -> str:
    """What an effect writes over, as the text of the model has it; empty where it adds to the model.

    Args:
        document: of the model without the effect.
        term: the effect at its place.
        values: of its parameters.
    """
    after = document.copy()
    term.effect.edit(after, term.at, values)
    had, has = _entries(document), _entries(after)
    found = [f'the {name} of <custom>, "{data}"' for name, data in had.items() if has.get(name) != data]
    for attribute, first in VERDICT.whole if term.effect.place != "world" else ():
        before, now = (one.effective(getattr(one, term.effect.place)(term.at), attribute) for one in (document, after))
        if before != now and any(map(float, before.split()[first:])):
            found.append(f'{attribute}="{before}"')
    return " and ".join(found)


def _entries(document: Document) -> dict[str, str]:
    """Data of the entries of `<custom>` by name."""
    return {entry.get("name", ""): entry.get("data", "") for entry in document.root.iterfind("custom/numeric")}
