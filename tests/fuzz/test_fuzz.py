"""A few hundred damaged and hostile files for every reader, the same ones each time; `make fuzz` tries 20,000."""

from __future__ import annotations

import json
import random
from typing import Any

import pytest
from case import run
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mutate import tree
from target import Target
from targets import TARGETS

COSTLY = {
    **{"model": 150, "model's parts": 100, "model to replay": 100, "plant": 150},
    **dict.fromkeys(("model to diagnose", "model to compensate"), 40),
}  # each compiles
JSON = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=20)),
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(st.text(max_size=8), inner, max_size=3)),
    max_leaves=6,
)
_made: dict[str, Target] = {}


@pytest.mark.parametrize("kind", TARGETS)
def test_a_valid_file_is_read(kind: str, tmp_path: Any) -> None:
    target = target_of(kind)
    for path, content in target.files.items():
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_bytes(content)
    target.read(tmp_path)
    assert not list(tmp_path.rglob("*.damaged"))


@pytest.mark.parametrize("kind", TARGETS)
def test_a_damaged_file_gives_a_documented_error_and_nothing_outside(kind: str) -> None:
    target, outcomes = target_of(kind), set[str]()

    @settings(
        max_examples=COSTLY.get(kind, 300), derandomize=True, deadline=None, database=None,
        suppress_health_check=list(HealthCheck),
    )  # fmt: skip
    @given(seed=st.integers(0, 2**48), value=JSON)
    def check(seed: int, value: Any) -> None:
        case = run(target, seed, value)
        outcomes.add(case.outcome)
        assert not case.fault, f"seed {seed}, value {value!r}: {case.outcome}\n{case.fault}"

    check()
    assert len(outcomes) > 1 or outcomes == {"read"}, "some damage shows"


@pytest.mark.parametrize("number", range(40))
def test_a_case_is_made_again_from_its_number(number: int) -> None:
    """The same bytes, whatever was damaged before."""
    valid = json.dumps({"a": [1, {"b": None}], "c": {"d": "e"}}).encode()
    first = tree(valid, random.Random(number))
    for other in range(1000, 1100):
        tree(valid, random.Random(other))
    assert tree(valid, random.Random(number)) == first


def target_of(kind: str) -> Target:
    if kind in ("policy.zip", "statistics", "checkpoint"):
        pytest.importorskip("torch")
    if kind == "checkpoint":
        pytest.importorskip("stable_baselines3")
    if kind == "recording.parquet":
        pytest.importorskip("pyarrow")
    if kind == "trial":
        pytest.importorskip("numba")
    return _made.setdefault(kind, _made.get(kind) or TARGETS[kind]())
