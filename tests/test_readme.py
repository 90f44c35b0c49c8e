"""The README is short, and its snippets print what it says they print."""

from __future__ import annotations

from pathlib import Path

import pages
import pytest

README = pages.ROOT / "README.md"


def test_it_can_be_read_in_three_minutes() -> None:
    assert len(README.read_text(encoding="utf-8").splitlines()) <= 150


def test_snippets_print_what_it_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "examples").symlink_to(pages.ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    snippets = pages.blocks(README, "python")
    assert len(snippets) == 4
    space: dict[str, object] = {"__name__": "__main__"}
    for snippet in snippets:
        exec(compile(snippet, "README.md", "exec"), space)
    assert not space["terminated"]
    assert space["truncated"]  # the policy stood for the whole ten seconds
    printed, said = capsys.readouterr().out.splitlines(), pages.blocks(README, "text")[0].splitlines()
    assert printed[0] == said[0]
    without, with_llnf = (float(line.split()[-2]) for line in printed[1:3])
    told_without, told_with = (float(line.split()[-2]) for line in said[1:3])
    assert with_llnf < without
    # Closed loops near a limit cycle amplify rounding, by up to 15 % from processor to processor.
    assert [without, with_llnf] == pytest.approx([told_without, told_with], rel=0.15)
    assert printed[3].startswith("stands after 10 s")
    assert printed[4].partition(" On held-out")[0] == said[4].partition(" On held-out")[0]
