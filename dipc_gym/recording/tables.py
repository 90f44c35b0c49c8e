"""Tables of numbers on disk: CSV, Parquet and npz, read with suspicion and written whole or not at all.

Every reader takes the file's bytes and a `choose` function that is told the column names and returns those to
load, so that text in columns nobody wants does no harm. What is wrong is said with file, column and row.
"""

from __future__ import annotations

import codecs
import csv
import hashlib
import io
import itertools
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from dipc_gym.safety import files
from dipc_gym.safety.untrusted import first_line

if TYPE_CHECKING:
    from numpy.typing import NDArray

MAX_BYTES = 1_000_000_000  # of a file
MAX_VALUES = 100_000_000  # rows times columns that are loaded
MAX_LINES = 20_000_000  # of a CSV file, empty ones included
MAX_LINE = 1_000_000  # characters of one of them
MAX_NAME = 210  # characters of a column's name, which may be a model's, of 200, with a prefix
BLOCK = 50_000  # lines that are parsed at a time; all at once would take ten times the file's size in memory
MAX_COLUMNS = 100_000  # of an npz file, those that are not loaded included
ENTRY = b"PK\x01\x02"  # what stands before each in its table of contents
FORMATS = (".csv", ".parquet", ".npz")
EMPTY = "drop its row, or fill it (a command holds until the next one; between readings go straight)"

Choose = Callable[[Sequence[str]], Sequence[str]]


class RecordingError(ValueError):
    """A recording that cannot be used; the message names the file, the column and the row, and the mend."""


@dataclass(frozen=True)
class Table:
    """Columns of numbers as they stood in a file.

    Attributes:
        names: every column name of the file, in its order.
        columns: the chosen columns, float64, all of one length.
        lines: for CSV, the line of the file that each row stood on; empty otherwise.
        sha256: digest of the file.
    """

    names: tuple[str, ...]
    columns: dict[str, NDArray[np.float64]]
    lines: Sequence[int]
    sha256: str


def row_label(lines: Sequence[int], index: int) -> str:
    """`line 12` where the file has lines, else `row 11`, counted from 1."""
    return f"line {lines[index]}" if len(lines) else f"row {index + 1}"


def check_format(path: Path) -> str:
    """The lower-case suffix of a file in one of the three formats.

    Raises:
        RecordingError: another suffix.
    """
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise RecordingError(f"{path}: unknown recording format {suffix!r}; use one of {', '.join(FORMATS)}")
    return suffix


def read_table(path: Path, choose: Choose) -> Table:
    """Read the chosen columns of a CSV, Parquet or npz file.

    Args:
        path: the file; its suffix says the format.
        choose: gets all column names, returns those to load; may raise RecordingError.

    Raises:
        RecordingError: whatever is wrong with the file.
    """
    suffix = check_format(path)
    if not path.is_file():
        raise RecordingError(f"{path}: no such recording")
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise RecordingError(f"{path}: {size:,} bytes, more than the {MAX_BYTES:,} allowed; split the recording")
    try:
        data = path.read_bytes()
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from None
    if not data.removeprefix(codecs.BOM_UTF8).strip():
        raise RecordingError(f"{path}: the file is empty")
    reader = {".csv": _read_csv, ".parquet": _read_parquet, ".npz": _read_npz}[suffix]
    names, columns, lines = reader(path, data, choose)
    lengths = {name: len(column) for name, column in columns.items()}
    if len(set(lengths.values())) > 1:
        raise RecordingError(f"{path}: the columns differ in length: {lengths}")
    return Table(tuple(names), columns, lines, hashlib.sha256(data).hexdigest())


def write_table(path: Path, columns: dict[str, NDArray[np.float64]], *, overwrite: bool = False) -> None:
    """Write columns to a CSV, Parquet or npz file; reading them gives the same bits.

    Raises:
        RecordingError: unknown suffix, its folder is missing, it cannot be written, or the file exists and `overwrite`
            is not set.
    """
    writer = {".csv": _write_csv, ".parquet": _write_parquet, ".npz": _write_npz}[check_format(path)]
    if path.exists() and not overwrite:
        raise RecordingError(f"{path}: exists already; choose another name or allow overwriting")
    if not path.parent.is_dir():
        raise RecordingError(f"{path}: its folder does not exist; make it first")
    try:
        with files.whole(path) as file:
            writer(path, file, columns)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written: {error.strerror or error}") from None


def _check_header(path: Path, names: Sequence[str]) -> None:
    if max(map(len, names), default=0) > MAX_NAME:
        raise RecordingError(f"{path}: a column's name has more than {MAX_NAME} characters; give it a shorter one")
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise RecordingError(f"{path}: columns {twice} appear more than once; rename or remove one")


def _check_size(path: Path, rows: int, columns: int) -> None:
    if rows * columns > MAX_VALUES:
        raise RecordingError(f"{path}: {rows:,} rows of {columns} columns are too many; split the recording")


# CSV


def _read_csv(path: Path, data: bytes, choose: Choose) -> tuple[list[str], dict[str, Any], Sequence[int]]:
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise RecordingError(f"{path}: the text is UTF-16; save the CSV as UTF-8")
    if b"\0" in data:
        raise RecordingError(f"{path}: not a CSV file: it contains binary data")
    if max(data.count(b"\n"), data.count(b"\r")) > MAX_LINES:
        raise RecordingError(f"{path}: more than {MAX_LINES:,} lines; split the recording")
    numbered = _lines(path, data)
    first, row = next(numbered)
    header = [name.strip() for name in _cells(path, row, first)]
    names = [name or f"column {k}" for k, name in enumerate(header, 1)]  # pandas writes its index without a name
    _check_csv_header(path, names, row)
    wanted = list(choose(names))
    place_of = {name: place for place, name in enumerate(names)}
    places = [place_of[name] for name in wanted]
    values, lines, count = [], [], 0
    while block := list(itertools.islice(numbered, BLOCK)):
        count += len(block)
        _check_size(path, count, max(1, len(wanted)))
        rows, standing = [row for _, row in block], [line for line, _ in block]
        found = _fast_values(rows, len(names), places)
        values.append(_slow_values(path, rows, standing, names, places) if found is None else found)
        lines.append(np.array(standing, dtype=np.int32))
    if not values:
        raise RecordingError(f"{path}: there is a header but no data")
    columns = {name: np.concatenate([block[:, k] for block in values]) for k, name in enumerate(wanted)}
    return names, columns, np.concatenate(lines)  # type: ignore[return-value]


def _lines(path: Path, data: bytes) -> Iterator[tuple[int, str]]:
    """The lines of a text that are not empty, with their numbers."""
    text = io.TextIOWrapper(io.BytesIO(data), encoding="utf-8-sig")
    number = 0
    try:
        while line := text.readline(MAX_LINE + 1):
            number += 1
            if len(line) > MAX_LINE:
                raise RecordingError(f"{path}, line {number}: longer than {MAX_LINE:,} characters; this is no table")
            if line := line.strip("\n") if not line.isspace() else "":
                yield number, line
    except UnicodeDecodeError:
        number = _undecodable(data)
        raise RecordingError(f"{path}, line {number}: not UTF-8 text; save the CSV as UTF-8") from None


def _undecodable(data: bytes) -> int:
    """The line of the first byte that is not UTF-8."""
    try:
        data.decode("utf-8")
    except UnicodeDecodeError as error:
        return data.count(b"\n", 0, error.start) + 1
    return 1


def _check_csv_header(path: Path, names: list[str], header: str) -> None:
    if len(names) == 1 and any(mark in header for mark in ";\t"):
        raise RecordingError(f"{path}: the columns are not separated by commas; write it with ',' (and '.' decimals)")
    if all(_is_number(name) for name in names):
        raise RecordingError(f"{path}: the first line must name the columns, but it holds numbers: {header[:60]!r}")
    _check_header(path, names)


def _fast_values(rows: list[str], width: int, places: list[int]) -> NDArray[np.float64] | None:
    """All numbers by NumPy's parser, or None where anything is unusual and the slow way must say what."""
    if any(row.count(",") != width - 1 or '"' in row for row in rows):
        return None
    try:
        return np.loadtxt(rows, delimiter=",", comments=None, usecols=places, ndmin=2, dtype=np.float64)
    except ValueError:
        return None


def _slow_values(
    path: Path, rows: list[str], lines: list[int], names: list[str], places: list[int]
) -> NDArray[np.float64]:
    """Row by row, to name the first fault exactly."""
    values = np.empty((len(rows), len(places)))
    for index, (row, line) in enumerate(zip(rows, lines, strict=True)):
        cells = _cells(path, row, line)
        if len(cells) != len(names):
            raise RecordingError(f"{path}, line {line}: {len(cells)} cells, but the header names {len(names)}")
        for k, place in enumerate(places):
            cell = cells[place].strip()
            if not _is_number(cell):
                what = f"{cell[:40]!r} is not a number" if cell else f"the cell is empty; {EMPTY}"
                raise RecordingError(f"{path}, line {line}, column {names[place]!r}: {what}")
            values[index, k] = float(cell)
    return values


def _cells(path: Path, row: str, line: int) -> list[str]:
    try:
        return next(csv.reader([row], strict=True))
    except (csv.Error, StopIteration) as error:
        raise RecordingError(f"{path}, line {line}: not a CSV row: {error}") from None


def _is_number(cell: str) -> bool:
    if "_" in cell:  # Python reads 1_000; no other program does
        return False
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _write_csv(path: Path, file: BinaryIO, columns: dict[str, NDArray[np.float64]]) -> None:
    odd = [name for name in columns if name != name.strip() or "\n" in name or "\r" in name]
    if odd:
        raise RecordingError(f"{path}: names with line breaks or outer blanks, {odd}, do not fit into a CSV header")
    text = io.TextIOWrapper(file, encoding="utf-8", newline="", write_through=True)
    writer = csv.writer(text, lineterminator="\n")  # it writes floats with repr, so nothing is lost
    writer.writerow(columns)
    writer.writerows(zip(*(column.tolist() for column in columns.values()), strict=True))
    text.detach()


# Parquet


def parquet(path: Path) -> Any:
    """The library that reads and writes Parquet files; one without it ends in a message that names this file."""
    try:
        import pyarrow.parquet
    except ImportError:
        raise RecordingError(
            f"{path}: Parquet needs pyarrow, which the extra `parquet` brings: pip install '.[parquet]' in a clone"
        ) from None
    return pyarrow


def _read_parquet(path: Path, data: bytes, choose: Choose) -> tuple[list[str], dict[str, Any], Sequence[int]]:
    arrow = parquet(path)
    try:
        file = arrow.parquet.ParquetFile(arrow.BufferReader(data))
        names = list(file.schema_arrow.names)
        rows = file.metadata.num_rows
    except Exception as error:  # a corrupt file can provoke any of a dozen classes
        raise RecordingError(f"{path}: not a readable Parquet file: {first_line(error)}") from None
    _check_header(path, names)
    wanted = list(choose(names))
    _check_size(path, rows, max(1, len(wanted)))
    columns = {}
    for name in wanted:
        kind = file.schema_arrow.field(name).type
        if not (arrow.types.is_floating(kind) or arrow.types.is_integer(kind)):
            raise RecordingError(
                f"{path}, column {name!r}: holds {kind}, not numbers; write it as floating-point numbers, time in s"
            )
        try:
            column = file.read(columns=[name]).column(name)  # a dot in the name may have brought others along
            values = column.cast(arrow.float64(), safe=False).to_numpy()
        except Exception as error:
            raise RecordingError(f"{path}, column {name!r}: cannot be read: {first_line(error)}") from None
        if column.null_count:
            index = int(np.flatnonzero(np.asarray(column.is_null()))[0])
            raise RecordingError(f"{path}, {row_label((), index)}, column {name!r}: the cell is empty; {EMPTY}")
        if len(values) != rows:
            raise RecordingError(f"{path}, column {name!r}: has {len(values):,} values, and the file says {rows:,}")
        columns[name] = np.array(values, dtype=np.float64)
    return names, columns, ()


def _write_parquet(path: Path, file: BinaryIO, columns: dict[str, NDArray[np.float64]]) -> None:
    arrow = parquet(path)
    arrow.parquet.write_table(arrow.table(columns), file)


# npz


def _read_npz(path: Path, data: bytes, choose: Choose) -> tuple[list[str], dict[str, Any], Sequence[int]]:
    if data.count(ENTRY) > MAX_COLUMNS:  # before there is an object for each
        raise RecordingError(f"{path}: more than {MAX_COLUMNS:,} arrays; save those of the recording alone")
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            names = [name.removesuffix(".npy") for name in archive.namelist()]
            _check_header(path, names)
            wanted = list(choose(names))
            entries = dict(zip(names, archive.infolist(), strict=True))
            _check_size(path, sum(entries[name].file_size for name in wanted) // 8, 1)
            columns, values = {}, 0
            for name in wanted:  # small numbers take less room in the file than in memory
                column = _npy(path, name, _entry(path, archive, entries[name]))
                _check_size(path, values := values + len(column), 1)
                columns[name] = column.astype(np.float64)
    except RecordingError:
        raise
    except Exception as error:  # a corrupt archive can provoke any of a dozen classes
        raise RecordingError(f"{path}: not a readable npz file: {first_line(error)}") from None
    return names, columns, ()


def _entry(path: Path, archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> bytes:
    """What an entry of the archive holds, no more of it than it says: a small file can unfold into gigabytes."""
    if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise RecordingError(f"{path}: {entry.filename} is packed otherwise than numpy packs; save it with numpy.savez")
    with archive.open(entry) as file:
        return file.read(entry.file_size)


def _npy(path: Path, name: str, data: bytes) -> NDArray[np.generic]:
    """One array of the archive as it is there; nothing is unpickled, and nothing allocated."""
    file = io.BytesIO(data)
    version = np.lib.format.read_magic(file)
    header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = header(file)
    if len(shape) != 1:
        raise RecordingError(f"{path}, column {name!r}: has shape {shape}; a column is one-dimensional")
    if dtype.kind not in "fiu":
        raise RecordingError(f"{path}, column {name!r}: holds {dtype}, not numbers")
    return np.frombuffer(data, dtype=dtype, count=shape[0], offset=file.tell())


def _write_npz(path: Path, file: BinaryIO, columns: dict[str, NDArray[np.float64]]) -> None:
    # Written entry by entry, because numpy.savez takes the names as keywords and has its own called `file`.
    with zipfile.ZipFile(file, "w") as archive:
        for name, values in columns.items():
            with archive.open(zipfile.ZipInfo(f"{name}.npy"), "w") as entry:
                np.lib.format.write_array(entry, np.asarray(values, dtype=np.float64), allow_pickle=False)
