"""The folder of a diagnosis: diagnosis.json, improved.xml, report.json and report.html; the page can be drawn again."""

from __future__ import annotations

import html
import json
import os
import shutil
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from dipc_gym.safety.files import finite, write_whole
from dipc_gym.safety.places import inside
from dipc_gym.sim2real.report import page, saved
from dipc_gym.sim2real.result import Details, Diagnosis

DIAGNOSIS, DETAILS, PAGE = "diagnosis.json", "report.json", "report.html"
OWN = ("improved.xml", DETAILS, PAGE, DIAGNOSIS)
DRAFTS = ".diagnosis-"  # what the folder of files that are not in place yet is called, with a few letters more


def save(
    found: Diagnosis, folder: str | Path, *, model: str = "the model", command: str = "", overwrite: bool = False
) -> Path:
    """Write a diagnosis; each file appears whole or not at all, and none before all are made.

    Args:
        found: what was found.
        folder: to write into; made if it does not exist.
        model: name of the model's file, for the report.
        command: that makes this again, for the report; none from Python.
        overwrite: whether a folder that is not empty may be replaced. Only the files that are written are.

    Raises:
        FileExistsError: the folder is not empty, or is a file.
        OSError: a file cannot be written; the message says at which, and which are whole.

    Returns:
        The folder.

    Example:
        >>> save(diagnose("arm.xml", recordings), "runs/arm")  # doctest: +SKIP
        PosixPath('runs/arm')
    """
    folder = Path(folder)
    check_free(folder, overwrite)
    check_names(found.files)
    for name in found.files:
        inside(folder, name)
    drawn = _page(found, model, command).encode()
    said = json.dumps(finite(found.to_dict()), indent=2, allow_nan=False) + "\n"
    texts = {
        **found.files,
        "improved.xml": found.improved.encode(),
        DETAILS: saved.text(saved.Drawn(model, command, found.details)).encode(),
        PAGE: drawn,
        DIAGNOSIS: said.encode(),
    }
    whole: list[str] = []
    at_work, gone = ".", "nothing was written, and what was there is untouched"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for draft_of_before in folder.glob(f"{DRAFTS}*"):  # of a run that was killed
            shutil.rmtree(draft_of_before, ignore_errors=True)
        with tempfile.TemporaryDirectory(dir=folder, prefix=DRAFTS) as draft:
            for at_work, text in texts.items():
                file = inside(draft, at_work)
                file.parent.mkdir(parents=True, exist_ok=True)
                write_whole(file, text)
            if (old := inside(folder, DIAGNOSIS)).exists():  # until all is in place, the folder has none
                old.unlink()
                gone = f"nothing was written, and {DIAGNOSIS} of before is gone"
            for at_work in texts:
                place = inside(folder, at_work)
                place.parent.mkdir(parents=True, exist_ok=True)
                (Path(draft) / at_work).replace(place)
                whole.append(at_work)
    except OSError as error:
        stand = f"whole are {', '.join(whole)} alone" if whole else gone
        reason = os.strerror(error.errno) if error.errno else error
        raise OSError(error.errno, f"{reason}, at {at_work}; {stand}", str(folder)) from error
    return folder


def redraw(folder: str | Path) -> Path:
    """Draw the report of a saved diagnosis again, from what the folder holds; nothing is simulated.

    Args:
        folder: that `save` or `dipc-gym diagnose` has filled. Its report.html is replaced.

    Raises:
        SavedError: diagnosis.json or report.json is not there, or not as it was written.
        PlaceError: a file of the folder is a link that leads out of it.
        OSError: the page cannot be written.

    Returns:
        The page.

    Example:
        >>> redraw("diagnosis")  # doctest: +SKIP
        PosixPath('diagnosis/report.html')
    """
    folder = Path(folder)
    diagnosis = saved.read_diagnosis(inside(folder, DIAGNOSIS))
    drawn = saved.read(inside(folder, DETAILS))
    place = inside(folder, PAGE)
    write_whole(place, page.render(_data(diagnosis, drawn.details, drawn.model, drawn.command)).encode())
    return place


def _data(diagnosis: Mapping[str, Any], details: Details | None, model: str, command: str) -> page.ReportData:
    return page.ReportData(model, diagnosis, details or Details(), command, diagnosis["notes"])


def _page(found: Diagnosis, model: str, command: str) -> str:
    """The page; without figures if one cannot be drawn, or the sentence alone: what was found goes before."""
    diagnosis = finite(found.to_dict())
    try:
        return page.render(_data(diagnosis, found.details, model, command))
    except Exception as error:  # whatever it is, the other files wait for this one
        why = f"({type(error).__name__}: {error}). Please report this with the files."
    bare = {**diagnosis, "missing": [{**one, "law": None} for one in diagnosis["missing"]]}
    notes = (*found.notes, f"The figures could not be drawn {why}")
    try:
        return page.render(page.ReportData(model, bare, command=command, notes=notes))
    except Exception:  # likewise
        told = "".join(f"<p>{html.escape(one)}</p>\n" for one in (found.sentence, f"The page could not be drawn {why}"))
        return f'<!doctype html>\n<html lang="en"><meta charset="utf-8"><title>Diagnosis</title>\n{told}</html>\n'


def check_free(folder: Path, overwrite: bool) -> None:
    """Refuse a folder that holds something, or that cannot be written: before the work rather than after it.

    Raises:
        FileExistsError: with what to do.
        PermissionError: likewise.
        PlaceError: a file of a diagnosis is there as a link that leads out of the folder.
    """
    nearest = next(place for place in (folder, *folder.absolute().parents) if place.exists())
    if not nearest.is_dir():
        raise FileExistsError(f"{nearest} is a file; name a folder for the results")
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise PermissionError(f"{nearest} may not be written; name another folder for the results")
    if folder.is_dir() and any(folder.iterdir()) and not (overwrite or _unfinished(folder)):
        raise FileExistsError(f"{folder} is not empty; name another folder or add --overwrite")
    for name in OWN:
        inside(folder, name)


def check_names(files: Iterable[str]) -> None:
    """Refuse a model with a file that is called as one of a diagnosis: both stand in one folder in the end.

    Args:
        files: that the model names, relative to it.

    Raises:
        ValueError: naming the file, and what to do.
    """
    for name in files:
        if name in OWN:
            raise ValueError(f"the model's own file {name} is called as a file of the diagnosis; give it another name")


def check_given(folder: Path, given: Iterable[str | Path]) -> None:
    """Refuse a folder in which results would take the place of what they are made from.

    Args:
        folder: of the results.
        given: files of the model and recordings.

    Raises:
        FileExistsError: naming the file, and what to do.
    """
    written = {(folder / name).resolve() for name in OWN}
    for file in map(Path, given):
        if file.resolve() in written:
            raise FileExistsError(f"{file} would be replaced by what is found from it; name another folder with --out")


def _unfinished(folder: Path) -> bool:
    """Whether a diagnosis was killed while it wrote here: its drafts are there, and what comes last is not."""
    return any(folder.glob(f"{DRAFTS}*")) and not (folder / DIAGNOSIS).exists()
