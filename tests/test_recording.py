"""Recordings: round trips, what is refused and how it is said, noise estimates, and averaged commands."""

import io
import itertools
import math
import pickle
import sys
import tracemalloc
import zipfile
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from dipc_gym import mjcf
from dipc_gym import recording as recordings
from dipc_gym.recording import Recorder, Recording, RecordingError, files, noise, read, resample_commands, tables, write
from dipc_gym.recording.checks import counted_on, notes, quantum
from dipc_gym.recording.degrees import IN_PYTHON, look_like_degrees, refuse_degrees, refuse_millimetres
from dipc_gym.recording.held import ROUNDING
from dipc_gym.recording.record import LARGEST
from dipc_gym.recording.units import FACTORS, check_kind, factor, of_command

SHARED = Path(__file__).parents[1] / "../shared"
FORMATS = [".csv", ".parquet", ".npz"]
RIG = """<mujoco>
  <worldbody>
    <body><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><joint name="cart" type="slide" axis="1 0 0"/>
      <body><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><joint name="pole" axis="0 1 0"/></body>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="cart" ctrlrange="-24 24"/></actuator>
  <sensor><jointpos name="cart" joint="cart"/><jointpos name="pole" joint="pole"/></sensor>
</mujoco>"""

# A body below its joint, in the place of one about it.
PENDULUM = 'pos="0 0 -0.3" mass="1" diaginertia="1 1 1"/><joint name="pole"'


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return mjcf.compile(RIG)


def run(n: int = 200, period: float = 0.002) -> dict[str, np.ndarray]:
    """Columns of a recording in which nothing is odd."""
    time = period * np.arange(n)
    return {
        "time": time,
        "motor": 6 * np.sin(30 * time),
        "cart": 0.1 * np.sin(9 * time),
        "pole": 0.5 * np.cos(7 * time),
    }


def table(columns: dict[str, np.ndarray]) -> list[list[str]]:
    return [list(columns), *([repr(float(cell)) for cell in row] for row in zip(*columns.values(), strict=True))]


def save(path: Path, rows: list[list[str]]) -> Path:
    path.write_text("\n".join(",".join(row) for row in rows) + "\n")
    return path


def refused(path: Path, model: mujoco.MjModel, **how: object) -> str:
    with pytest.raises(RecordingError) as caught:
        read(path, model, **how)  # type: ignore[arg-type]
    assert str(path) in str(caught.value)
    return str(caught.value)


# Round trips

NUMBERS = st.floats(-LARGEST, LARGEST)
NAMES = st.lists(
    st.one_of(
        st.sampled_from(
            ["time", "cart", "ctrl:cart", "sensor:cart", "cart.pos", "file", "a,b", 'say "x"', "a/b", "é", "ctrl:"]
        ),
        st.text(st.characters(codec="utf-8", min_codepoint=32), min_size=1, max_size=8).filter(
            lambda name: name == name.strip()
        ),
    ),
    max_size=3,
    unique=True,
)


@st.composite
def any_recording(draw: st.DrawFn) -> Recording:
    n = draw(st.integers(1, 30))
    actuators, sensors = draw(NAMES), draw(NAMES)
    time = np.unique(draw(arrays(np.float64, n, elements=NUMBERS, unique=True)))
    commands = draw(arrays(np.float64, (len(time), len(actuators)), elements=NUMBERS))
    sensed = draw(arrays(np.float64, (len(time), len(sensors)), elements=NUMBERS))
    return Recording("drawn", time, commands, sensed, tuple(actuators), tuple(sensors))


@pytest.mark.parametrize("suffix", FORMATS)
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=60)
@given(recording=any_recording())
def test_written_and_read_again_it_has_the_same_bits(
    tmp_path: Path, suffix: str, recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / f"run{suffix}"
    write(recording, path, overwrite=True)
    monkeypatch.setattr(files, "MIN_SAMPLES", 1)
    monkeypatch.setattr(mjcf, "controls", lambda model: list(recording.actuator_names))
    monkeypatch.setattr(mjcf, "scalar_sensors", lambda model: list(recording.sensor_names))
    monkeypatch.setattr(files.checks, "notes", lambda recording, model: ())
    monkeypatch.setattr(files, "of_sensor", lambda model, name: "")
    monkeypatch.setattr(files, "of_command", lambda model, name: "")
    again = read(path, None)
    assert (again.actuator_names, again.sensor_names) == (recording.actuator_names, recording.sensor_names)
    for kind in ("time", "commands", "sensors"):
        assert getattr(again, kind).tobytes() == getattr(recording, kind).tobytes()
    assert not again.ignored


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_large_recording_is_not_read_row_by_row_and_is_written_whole(
    tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = [f"s{k}" for k in range(18)]
    joints = "".join(f'<sensor><jointpos name="{name}" joint="cart"/></sensor>' for name in names)
    model = mjcf.compile(RIG.replace("<sensor>", joints + "<sensor>", 1))
    rng = np.random.default_rng(0)
    n = 10_000
    sensors = rng.normal(size=(n, 20))
    path = tmp_path / f"large{suffix}"
    write(
        Recording(
            "large", np.arange(n) * 0.002, rng.normal(size=(n, 1)), sensors, ("motor",), (*names, "cart", "pole")
        ),
        path,
    )
    monkeypatch.setattr(tables, "_slow_values", None)  # which takes ten times as long
    recording = read(path, model)
    assert recording.sensors.tobytes() == sensors.tobytes()
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


def test_columns_share_a_name_under_prefixes(tmp_path: Path) -> None:
    model = mjcf.compile(RIG.replace('motor name="motor"', 'motor name="cart"'))
    columns = run()
    recording = Recording(
        "r",
        columns["time"],
        columns["motor"][:, None],
        np.stack([columns["cart"], columns["pole"]], 1),
        ("cart",),
        ("cart", "pole"),
    )
    path = write(recording, tmp_path / "r.csv")
    assert path.read_text().startswith("time,ctrl:cart,sensor:cart,pole\n")
    again = read(path, model)
    np.testing.assert_array_equal(again.commands[:, 0], columns["motor"])
    np.testing.assert_array_equal(again.sensors[:, 0], columns["cart"])
    save(tmp_path / "u.csv", table(run()))
    message = refused(tmp_path / "u.csv", model)
    assert "'cart' may be an actuator or a sensor" in message
    assert "'ctrl:cart' or 'sensor:cart'" in message
    mapped = read(tmp_path / "u.csv", model, mapping={"motor": "ctrl:cart", "cart": "sensor:cart"})
    np.testing.assert_array_equal(mapped.commands[:, 0], columns["motor"])


def test_columns_are_mapped_and_units_converted(tmp_path: Path, model: mujoco.MjModel) -> None:
    columns = run()
    rows = table(
        {
            "stamp": 1e3 * columns["time"],
            "u": columns["motor"],
            "x": 1e3 * columns["cart"],
            "angle": np.degrees(columns["pole"]),
        }
    )
    path = save(tmp_path / "r.csv", rows)
    mapping = {"stamp": "time", "u": "motor", "x": "cart", "angle": "pole"}
    recording = read(path, model, mapping=mapping, units={"time": "ms", "x": "mm", "pole": "deg"})
    np.testing.assert_allclose(recording.time, columns["time"], rtol=1e-14)
    np.testing.assert_allclose(recording.sensors, np.stack([columns["cart"], columns["pole"]], 1), rtol=1e-14)
    assert recording.notes == ()
    assert "there is no column 'pole'" in (message := refused(path, model, mapping={"pole": "angle"}))
    assert "FILE_COLUMN=MODEL_NAME" in message
    assert "did you mean 'angle'?" in refused(path, model, mapping={"angel": "pole"})
    assert "mapped to 'arm', which is not in the model" in refused(path, model, mapping={"x": "arm"})
    assert "both mean 'sensor:cart'" in refused(path, model, mapping={**mapping, "u": "cart"})
    assert "unknown unit 'furlong'" in refused(path, model, mapping=mapping, units={"x": "furlong"})
    assert "given for 'y'" in refused(path, model, mapping=mapping, units={"y": "mm"})
    assert "unit of 'pole': it is measured in rad: use rad" in refused(
        path, model, mapping=mapping, units={"pole": "mm"}
    )
    assert "measured in m: use m, cm" in refused(path, model, mapping=mapping, units={"x": "deg"})
    assert "measured in s: use s, ms" in refused(path, model, mapping=mapping, units={"time": "rad"})


def test_units_are_si() -> None:
    assert factor("deg") * 180 == math.pi
    assert factor("rpm") * 60 == 2 * math.pi
    assert factor("0.25") == 0.25
    assert factor("-deg") * 180 == -math.pi
    assert all(value > 0 for value in FACTORS.values())
    for wrong in ("", "nan", "inf", "0", "Deg"):
        with pytest.raises(ValueError, match="unknown unit"):
            factor(wrong)


@pytest.mark.parametrize(("unit", "volts"), [("V", 1.0), ("mV", 1e-3), ("-mV", -1e-3), ("%", 1e-2), ("2.5", 2.5)])
def test_a_command_takes_any_unit_for_a_model_does_not_say_what_it_is_measured_in(unit: str, volts: float) -> None:
    check_kind(unit, "")
    assert factor(unit) == volts


# What is refused


def corrupt(line: int, column: int, cell: str) -> list[list[str]]:
    rows = table(run())
    rows[line - 1][column] = cell
    return rows


@pytest.mark.parametrize("quoted", [False, True])
@pytest.mark.parametrize(
    ("line", "column", "cell", "said"),
    [
        (2, 0, "start", "line 2, column 'time': 'start' is not a number"),
        (57, 2, "1.2.3", "line 57, column 'cart': '1.2.3' is not a number"),
        (57, 2, "1_000", "line 57, column 'cart': '1_000' is not a number"),
        (201, 3, "", "line 201, column 'pole': the cell is empty"),
        (33, 3, "nan", "line 33, column 'pole': nan is not a finite number (1 such cells)"),
        (33, 1, "-inf", "line 33, column 'motor': -inf is not a finite number"),
        (33, 1, "1e999", "line 33, column 'motor': inf is not a finite number"),
        (33, 3, "-9e307", "line 33, column 'pole': -9e+307 is beyond all measure (1 such cells)"),
        (44, 0, "0.08", "line 44, column 'time': time must increase, but 0.08 follows 0.082"),
        (44, 0, "0.082", "time must increase, but 0.082 follows 0.082 (1 such places)"),
        (20, 3, "0.1,0.2", "line 20: 5 cells, but the header names 4"),
    ],
)
def test_faulty_cells_are_named_by_line_and_column(
    tmp_path: Path, model: mujoco.MjModel, line: int, column: int, cell: str, said: str, quoted: bool
) -> None:
    rows = corrupt(line, column, cell)
    if quoted:  # quotes anywhere take the slow way, which must come to the same words
        rows[2][0] = f'"{rows[2][0]}"'
    assert said in refused(save(tmp_path / "r.csv", rows), model)


def test_lines_are_counted_with_blank_ones(tmp_path: Path, model: mujoco.MjModel) -> None:
    rows = corrupt(10, 2, "x")
    path = tmp_path / "r.csv"
    path.write_bytes(("\r\n\r\n" + "\r\n".join(",".join(row) for row in rows)).encode())
    assert "line 12, column 'cart'" in refused(path, model)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "the file is empty"),
        (b" \n\n", "the file is empty"),
        (b"\xef\xbb\xbf\r\n", "the file is empty"),
        (b"time,motor,cart,pole\n", "there is a header but no data"),
        (b"\x89PNG\r\n\x1a\n\0\0\0", "contains binary data"),
        (b"time,motor\n1,\xff\n", "line 2: not UTF-8"),
        ("time,motor".encode("utf-16"), "UTF-16; save the CSV as UTF-8"),
        (b"0,1,2,3\n1,2,3,4\n", "the first line must name the columns"),
        (b"time;motor;cart;pole\n0;1;2;3\n", "not separated by commas"),
        (b"time,motor,cart,cart\n0,1,2,3\n", "columns ['cart'] appear more than once"),
        (b"time,motor,cart," + 211 * b"x" + b"\n0,1,2,3\n", "a column's name has more than 210 characters"),
        (b"time,motor,cart,pole\n" + b"0,1,2,3\n" * 2, "2 samples are too few"),
        (b'time,motor,cart,"pole\n0,1,2,3\n', "line 1: not a CSV row"),
    ],
)
def test_files_that_are_no_recordings(tmp_path: Path, model: mujoco.MjModel, content: bytes, said: str) -> None:
    path = tmp_path / "r.csv"
    path.write_bytes(content)
    assert said in refused(path, model)


def test_a_servo_is_asked_for_angles(tmp_path: Path) -> None:
    """What it is sent has a unit, and what no joint can do is noted unless that was told."""
    servo = '<position name="motor" joint="pole" kp="3"/>'
    motor = '<motor name="motor" joint="cart" ctrlrange="-24 24"/>'
    model = mjcf.compile(RIG.replace(motor, servo).replace('name="pole" axis', 'range="-60 60" name="pole" axis'))
    columns = run(2000)
    columns["motor"] = np.degrees(columns["pole"])
    path = save(tmp_path / "r.csv", table(columns))
    assert "measured in rad: use rad" in refused(path, model, units={"motor": "mm"})
    assert "say --unit motor=deg" in " ".join(read(path, model).notes)
    assert "--unit motor" not in " ".join(read(path, model, units={"motor": "rad"}).notes)
    converted = read(path, model, units={"motor": "deg"})
    np.testing.assert_allclose(converted.commands[:, 0], columns["pole"], atol=1e-12)
    assert "--unit motor" not in " ".join(converted.notes)


@pytest.mark.parametrize(
    ("actuator", "unit"),
    [
        ('<position name="a" joint="pole" kp="3" kv="1"/>', "rad"),
        ('<position name="a" joint="cart" kp="3"/>', "m"),
        ('<position name="a" joint="pole" kp="3" gear="2"/>', ""),
        ('<velocity name="a" joint="cart" kv="2"/>', "m/s"),
        ('<intvelocity name="a" joint="pole" kp="3" actrange="-1 1"/>', "rad/s"),
        ('<motor name="a" joint="pole"/>', "N m"),
        ('<motor name="a" joint="cart"/>', "N"),
        ('<motor name="a" joint="cart" gear="9"/>', ""),
        ('<dcmotor name="a" joint="cart" motorconst="0.1" resistance="1" input="voltage"/>', "V"),
        ('<general name="a" joint="cart" gainprm="2" biastype="affine" biasprm="1 0 0"/>', ""),
        ('<dcmotor name="a" joint="cart" motorconst="0.1" resistance="1" controller="3 1 0.1" input="pos"/>', "m"),
        ('<pid name="a" joint="pole" kp="3" input="vel"/>', "rad/s"),
    ],
)
def test_units_of_commands(actuator: str, unit: str) -> None:
    model = mjcf.compile(RIG.replace("<actuator>", f"<actuator>{actuator}"))
    assert of_command(model, "a") == unit
    for name in ("pos", "vel"):  # as inputs of others are called
        text = RIG.replace("<actuator>", f"<actuator>{actuator}").replace('"a"', f'"{name}"')
        assert of_command(mjcf.compile(text), name) == unit


def test_each_input_of_an_actuator_has_its_unit() -> None:
    servo = '<dcmotor name="a" joint="cart" motorconst="0.1" resistance="1" controller="3 1 0.1" input="pos vel"/>'
    model = mjcf.compile(RIG.replace("<actuator>", f"<actuator>{servo}"))
    assert [of_command(model, name) for name in mjcf.controls(model)[:2]] == ["m", "m/s"]


def test_the_unit_of_a_sensor_says_nothing_of_a_command_of_that_name(tmp_path: Path) -> None:
    text = RIG.replace('<motor name="motor" joint="cart" ctrlrange="-24 24"/>', '<position name="pole" joint="pole"/>')
    model = mjcf.compile(text.replace('name="pole" axis', 'range="-60 60" name="pole" axis'))
    columns = run(2000)
    columns["ctrl:pole"], columns["sensor:pole"] = np.degrees(columns["pole"]), columns.pop("pole")
    path = save(tmp_path / "r.csv", table(columns))
    note = "say --unit ctrl:pole=deg"
    assert note in " ".join(read(path, model, units={"sensor:pole": "rad"}).notes)
    for unit in ("deg", "rad"):
        assert note not in " ".join(read(path, model, units={"ctrl:pole": unit}).notes)


def test_a_missing_column_lists_both_sides(tmp_path: Path, model: mujoco.MjModel) -> None:
    columns = run()
    columns["theta"] = columns.pop("pole")
    message = refused(save(tmp_path / "r.csv", table(columns)), model)
    assert "no column for ['pole']" in message
    assert "the file has ['time', 'motor', 'cart', 'theta']" in message
    assert "controls ['motor'] and sensors ['cart', 'pole']" in message
    assert "--map" in message


def test_a_misspelt_column_is_told_from_others(tmp_path: Path, model: mujoco.MjModel) -> None:
    columns = run()
    columns["ploe"] = columns.pop("pole")
    path = save(tmp_path / "r.csv", table(columns))
    assert refused(path, model).endswith("; did you mean --map ploe=pole?")
    assert "did you mean 'motor'?" in refused(path, model, mapping={"mot": "motor"})  # which is a column too
    shared = mjcf.compile(RIG.replace('motor name="motor"', 'motor name="cart"'))
    del columns["cart"]
    message = refused(save(tmp_path / "r.csv", table(columns)), shared)
    assert "no column for ['ctrl:cart', 'sensor:cart', 'pole']" in message  # the prefix where two share a name


def test_unknown_columns_are_ignored_and_listed_whatever_they_hold(tmp_path: Path, model: mujoco.MjModel) -> None:
    rows = [
        ["", *row[:2], "state", *row[2:]] if k == 0 else [str(k), *row[:2], "moving", *row[2:]]
        for k, row in enumerate(table(run()))
    ]
    recording = read(save(tmp_path / "r.csv", rows), model)
    assert recording.ignored == ("column 1", "state")
    assert "ignored" in recording.notes[0]
    np.testing.assert_array_equal(recording.sensors[:, 0], run()["cart"])


def test_paths_that_are_no_recordings(tmp_path: Path, model: mujoco.MjModel, monkeypatch: pytest.MonkeyPatch) -> None:
    assert "no such recording" in refused(tmp_path / "none.csv", model)
    assert "unknown recording format '.txt'" in refused(tmp_path / "r.txt", model)
    (tmp_path / "folder.csv").mkdir()
    assert "no such recording" in refused(tmp_path / "folder.csv", model)
    path = save(tmp_path / "r.csv", table(run()))
    monkeypatch.setattr("dipc_gym.recording.tables.MAX_BYTES", 100)
    assert "split the recording" in refused(path, model)
    monkeypatch.undo()
    monkeypatch.setattr("dipc_gym.recording.tables.MAX_VALUES", 100)
    assert "too many; split" in refused(path, model)


def npz(path: Path, **columns: np.ndarray) -> Path:
    np.savez(path, **columns)  # type: ignore[arg-type]
    return path


class Trap:
    def __reduce__(self) -> tuple[object, tuple[str, ...]]:
        return (Path.touch, (Path("sprung"),))


def test_npz_is_never_unpickled(tmp_path: Path, model: mujoco.MjModel, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    columns = {**run(), "pole": np.array([Trap()] * 200, dtype=object)}
    assert "holds object, not numbers" in refused(npz(tmp_path / "r.npz", **columns), model)
    assert not (tmp_path / "sprung").exists()
    (tmp_path / "p.npz").write_bytes(pickle.dumps(run()))
    assert "not a readable npz file" in refused(tmp_path / "p.npz", model)


def test_npz_unfolds_into_no_more_than_it_says(tmp_path: Path, model: mujoco.MjModel) -> None:
    """An entry of 40 MB that says it has 928 bytes; and one that is packed so that no reader can stop in time."""
    path, entry = tmp_path / "r.npz", zipfile.ZipInfo("time.npy")
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(entry, bytes(40_000_000), zipfile.ZIP_DEFLATED)
        for name in ("motor", "cart", "pole"):
            archive.writestr(f"{name}.npy", b"")
        entry.file_size = 928
    tracemalloc.start()
    assert "not a readable npz file" in refused(path, model)
    assert tracemalloc.get_traced_memory()[1] < 4_000_000
    tracemalloc.stop()
    with zipfile.ZipFile(path, "w", zipfile.ZIP_LZMA) as archive:
        for name in ("time", "motor", "cart", "pole"):
            archive.writestr(f"{name}.npy", b"")
    assert "save it with numpy.savez" in refused(path, model)


def test_an_npz_of_very_many_arrays_is_refused_before_they_are_listed(tmp_path: Path, model: mujoco.MjModel) -> None:
    path = tmp_path / "r.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("time.npy", b"")
    path.write_bytes(path.read_bytes() + b"PK\x01\x02" * 100_000)
    assert "more than 100,000 arrays" in refused(path, model)


def test_npz_shapes_and_types(tmp_path: Path, model: mujoco.MjModel) -> None:
    columns = run()
    path = tmp_path / "r.npz"
    assert "has shape (200, 1)" in refused(npz(path, **{**columns, "pole": columns["pole"][:, None]}), model)
    assert "differ in length" in refused(npz(path, **{**columns, "pole": columns["pole"][1:]}), model)
    assert "holds complex128" in refused(npz(path, **{**columns, "pole": columns["pole"] + 1j}), model)
    bad = {**columns, "pole": np.where(columns["time"] == 0.02, np.nan, columns["pole"])}
    assert "row 11, column 'pole': nan" in refused(npz(path, **bad), model)
    whole = npz(path, **{**columns, "motor": np.ones(200, dtype=np.int16), "comment": np.array("text")})
    assert read(whole, model).commands.dtype == np.float64


def test_an_npz_that_promises_more_than_it_holds(tmp_path: Path, model: mujoco.MjModel) -> None:
    path = tmp_path / "r.npz"
    with zipfile.ZipFile(path, "w") as archive:
        for name in run():
            entry = io.BytesIO()
            np.lib.format.write_array_header_1_0(entry, {"descr": "<f8", "fortran_order": False, "shape": (10**12,)})
            archive.writestr(f"{name}.npy", entry.getvalue())
    assert "not a readable npz file" in refused(path, model)


def test_parquet_types_and_gaps(tmp_path: Path, model: mujoco.MjModel) -> None:
    import pyarrow
    import pyarrow.parquet

    columns: dict[str, object] = dict(run())
    path = tmp_path / "r.parquet"
    pyarrow.parquet.write_table(pyarrow.table({**columns, "pole": ["a"] * 200}), path)
    assert "column 'pole': holds string, not numbers" in refused(path, model)
    pyarrow.parquet.write_table(pyarrow.table({**columns, "pole": [*[0.5] * 199, None]}), path)
    assert "row 200, column 'pole': the cell is empty" in refused(path, model)
    pyarrow.parquet.write_table(pyarrow.table({**columns, "pole": np.arange(200, dtype=np.int8)}), path)
    assert read(path, model).sensors[7, 1] == 7.0
    path.write_bytes(path.read_bytes()[:-20])
    assert "not a readable Parquet file" in refused(path, model)


def test_without_pyarrow_parquet_says_what_to_install(
    tmp_path: Path, model: mujoco.MjModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "r.parquet").write_bytes(b"PAR1")
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    assert "pip install '.[parquet]'" in refused(tmp_path / "r.parquet", model)


@pytest.mark.parametrize("suffix", FORMATS)
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=150)
@given(data=st.data())
def test_damage_raises_nothing_but_recording_errors(
    tmp_path: Path, model: mujoco.MjModel, suffix: str, data: st.DataObject
) -> None:
    good = tmp_path / f"good{suffix}"
    if not good.exists():
        columns = run(25)
        sensors = np.stack([columns["cart"], columns["pole"]], 1)
        write(Recording("g", columns["time"], columns["motor"][:, None], sensors, ("motor",), ("cart", "pole")), good)
    content = bytearray(good.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.integers(0, len(content)))
        length = data.draw(st.sampled_from([0, 1, 2, 10, 1000]))
        junk = st.binary(max_size=6) | st.sampled_from([b",", b"\n", b'"', b"nan", b"1e400", b"\r", b"-", b"\xc3\xa9"])
        content[place : place + length] = data.draw(junk)
    path = tmp_path / f"damaged{suffix}"
    path.write_bytes(content)
    try:
        recording = read(path, model)
    except RecordingError:
        return
    assert np.all(np.isfinite(recording.sensors))


# Writing


def small() -> Recording:
    recorder = Recorder(["motor"], ["cart"])
    for k in range(5):
        recorder.append(0.1 * k, [k], 2.0 * k)
    return recorder.recording("small")


@pytest.mark.parametrize("suffix", FORMATS)
def test_nothing_is_overwritten_or_half_written(tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(small(), tmp_path / f"r{suffix}")
    before = path.read_bytes()
    with pytest.raises(RecordingError, match="exists already"):
        write(small(), path)
    write(small(), path, overwrite=True)

    def fail(*_: object) -> None:
        raise KeyboardInterrupt

    writer = {".csv": "_write_csv", ".parquet": "_write_parquet", ".npz": "_write_npz"}[suffix]
    monkeypatch.setattr(f"dipc_gym.recording.tables.{writer}", fail)
    with pytest.raises(KeyboardInterrupt):
        write(small(), path, overwrite=True)
    assert path.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


def test_where_one_cannot_write(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="folder does not exist"):
        write(small(), tmp_path / "none/r.csv")
    with pytest.raises(RecordingError, match="unknown recording format"):
        write(small(), tmp_path / "r.xlsx")
    (tmp_path / "r.csv").mkdir()
    with pytest.raises(RecordingError, match="cannot be written"):
        write(small(), tmp_path / "r.csv", overwrite=True)
    odd = Recording("odd", np.zeros(1), np.zeros((1, 0)), np.zeros((1, 1)), (), ("two\nlines",))
    with pytest.raises(RecordingError, match="do not fit into a CSV header"):
        write(odd, tmp_path / "odd.csv")


# The object


def test_a_recording_is_checked_and_cannot_be_changed() -> None:
    recording = small()
    assert (len(recording), recording.duration) == (5, pytest.approx(0.4))
    assert recording.period == pytest.approx(0.1)
    with pytest.raises(ValueError, match="read-only"):
        recording.sensors[0, 0] = 1.0
    with pytest.raises(RecordingError, match="commands has shape"):
        Recording("r", np.arange(3), np.zeros((3, 2)), np.zeros((3, 0)), ("a",), ())
    with pytest.raises(RecordingError, match="row 2, column 'time': time must increase"):
        Recording("r", np.zeros(2), np.zeros((2, 0)), np.zeros((2, 0)), (), ())
    with pytest.raises(RecordingError, match="time has shape"):
        Recording("r", np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0)), (), ())
    assert recording.sha256 != Recording("r", np.zeros(1), np.zeros((1, 0)), np.zeros((1, 0)), (), ()).sha256


def test_slices_and_splits() -> None:
    first, last = small().split(0.6)
    np.testing.assert_array_equal(np.concatenate([first.time, last.time]), small().time)
    assert len(first) == 3
    assert first.name == "small[0:3]"
    np.testing.assert_array_equal(small().slice(1, -1).sensors[:, 0], [2.0, 4.0, 6.0])
    for wrong in (0.0, 1.0):
        with pytest.raises(RecordingError, match="cannot split"):
            small().split(wrong)
    with pytest.raises(RecordingError, match="no samples"):
        small().slice(3, 3)


def test_the_recorder_counts_its_numbers() -> None:
    recorder = Recorder(["motor"], ["cart"])
    with pytest.raises(RecordingError, match="nothing was recorded"):
        recorder.recording("r")
    with pytest.raises(RecordingError, match="2 commands and 1 sensors"):
        recorder.append(0.0, [1.0, 2.0], [0.0])
    recorder.append(0.0, 1.0, np.float32(0.5))
    assert recorder.recording("r").sensors[0, 0] == 0.5


# Notes


def noted(tmp_path: Path, model: mujoco.MjModel, **changed: np.ndarray) -> str:
    return "\n".join(read(save(tmp_path / "r.csv", table({**run(2000), **changed})), model).notes)


def test_nothing_odd_nothing_noted(tmp_path: Path, model: mujoco.MjModel) -> None:
    assert noted(tmp_path, model) == ""
    steps = np.repeat([3.0, -3.0, 6.0, -6.0], 500)
    assert noted(tmp_path, model, motor=steps) == ""
    settling = 0.1 * (1 - np.exp(-np.arange(2000) / 60))
    assert noted(tmp_path, model, cart=np.round(settling / 2e-5) * 2e-5) == ""
    rests = 0.1 * np.cos(np.minimum(np.arange(2000) / 500, np.pi))
    assert noted(tmp_path, model, cart=np.round(rests / 2e-5) * 2e-5) == ""


def test_dead_and_clipped_channels_are_noted(tmp_path: Path, model: mujoco.MjModel) -> None:
    columns = run(2000)
    assert "sensor 'pole' is constant" in noted(tmp_path, model, pole=np.full(2000, 0.2))
    assert "command 'motor' is constant" in noted(tmp_path, model, motor=np.zeros(2000))
    clipped = np.clip(columns["motor"], -20.0, 4.0)
    assert "command 'motor' sits at its highest value, 4," in noted(tmp_path, model, motor=clipped)
    switched = np.where(np.sin(np.arange(2000) / 90) > 0.2, 5.0, 0.0)
    assert "sits at" not in noted(tmp_path, model, motor=switched)
    coarse = np.round(np.clip(columns["cart"], -0.08, 1.0) / 2e-5) * 2e-5
    assert "sensor 'cart' sits at its lowest value, -0.08" in noted(tmp_path, model, cart=coarse)


def test_what_looks_like_degrees_stops_until_the_unit_is_told(tmp_path: Path, model: mujoco.MjModel) -> None:
    columns = run(2000)
    in_degrees = save(tmp_path / "log.csv", table({**columns, "pole": np.degrees(columns["pole"])}))
    weight = mjcf.compile(RIG.replace('pos="0 0 0" mass="1" diaginertia="1 1 1"/><joint name="pole"', PENDULUM))
    with pytest.raises(RecordingError, match=r"log\.csv: sensor 'pole' reaches .* --unit pole=deg .* --unit pole=rad"):
        refuse_degrees([read(in_degrees, weight)], weight, ())
    refuse_degrees([read(in_degrees, weight)], weight, ("pole",))
    for unit in ("deg", "rad"):
        refuse_degrees([read(in_degrees, weight, units={"pole": unit})], weight)
    part = read(in_degrees, weight, units={"cart": "mm"}).slice(0, 1500)
    assert part.told == ("cart",)
    with pytest.raises(RecordingError, match=r"read it with units={'pole': 'deg'} if .* told=\('pole',\)"):
        refuse_degrees([part], weight, mend=IN_PYTHON)
    refuse_degrees([read(save(tmp_path / "rad.csv", table(columns)), weight)], weight, ())
    refuse_degrees([read(in_degrees, model)], model, ())  # nothing weighs on this pole: it may turn as it likes
    limited = mjcf.compile(RIG.replace('name="pole" axis', 'range="-30 30" name="pole" axis'))
    with pytest.raises(RecordingError, match="looks like degrees"):
        refuse_degrees([read(in_degrees, limited)], limited, ())


def test_a_pole_that_goes_round_and_round_is_no_angle_in_degrees(tmp_path: Path) -> None:
    weight = mjcf.compile(RIG.replace('pos="0 0 0" mass="1" diaginertia="1 1 1"/><joint name="pole"', PENDULUM))
    weight.opt.timestep = 0.002
    data = mujoco.MjData(weight)
    data.qvel[1] = 9.0
    rows = []
    for k in range(2000):
        rows.append((data.time, np.sin(k / 90), *data.qpos))
        mujoco.mj_step1(weight, data)
        data.ctrl[:] = rows[-1][1]
        mujoco.mj_step2(weight, data)
    time, motor, cart, pole = np.array(rows).T
    assert pole.max() > 4 * math.pi
    columns = {"time": time, "motor": motor, "cart": cart, "pole": pole}
    refuse_degrees([read(save(tmp_path / "turns.csv", table(columns)), weight)], weight, ())
    assert not any("pole" in note for note in read(tmp_path / "turns.csv", weight).notes)
    swings = save(tmp_path / "swings.csv", table({**columns, "pole": np.degrees(0.3 * np.sin(2 * time))}))
    with pytest.raises(RecordingError, match="looks like degrees"):
        refuse_degrees([read(swings, weight)], weight, ())


def test_suspect_units_are_noted(tmp_path: Path, model: mujoco.MjModel) -> None:
    columns = run(2000)
    assert "--unit pole=deg" in noted(tmp_path, model, pole=np.degrees(columns["pole"]))
    turned = save(tmp_path / "r.csv", table({**columns, "pole": np.degrees(columns["pole"])}))
    assert read(turned, model, units={"pole": "rad"}).notes == ()  # told that it is none
    assert "--unit cart=mm" in noted(tmp_path, model, cart=1e3 * columns["cart"])
    for unit, of_a_second in {"ms": 1e3, "us": 1e6, "ns": 1e9}.items():
        assert f"--unit time={unit}" in noted(tmp_path, model, time=of_a_second * columns["time"])
    assert "leaves its ctrlrange -24 to 24" in noted(tmp_path, model, motor=10 * columns["motor"])
    limited = mjcf.compile(RIG.replace('name="pole" axis', 'range="-30 30" name="pole" axis'))
    assert "--unit pole=deg" in noted(tmp_path, limited, pole=6 * columns["pole"])


def test_who_records_a_rig_against_its_stops_is_told(tmp_path: Path) -> None:
    limited = mjcf.compile(RIG.replace('name="pole" axis', 'range="-10 10" name="pole" axis'))
    swing = 0.2 * np.sin(2 * math.pi * run(2000)["time"])  # past 10 degrees twice a second
    times = 2 * round(run(2000)["time"][-1])
    assert f"goes beyond the limits of its joint, -0.1745 to 0.1745, {times} times" in noted(
        tmp_path, limited, pole=swing
    )
    assert "limits of its joint" not in noted(tmp_path, limited, pole=0.8 * swing)
    homed = mjcf.compile(RIG.replace('name="pole" axis', 'range="0 30" name="pole" axis'))
    resting = np.maximum(swing, 0.0) + 1e-4 * np.random.default_rng(0).normal(size=len(swing))
    assert "limits of its joint" not in noted(tmp_path, homed, pole=resting)


@settings(deadline=None, max_examples=60)
@given(
    start=st.floats(-math.pi, math.pi),
    swings=st.lists(st.floats(-12.0, 12.0), min_size=1, max_size=3),
    lowest=st.sampled_from([-math.pi, 0.0]),
)
def test_an_angle_that_starts_again_is_counted_on(start: float, swings: list[float], lowest: float) -> None:
    time = np.linspace(0, 6, 600)
    whole = start + sum(swing * np.sin((k + 1) * time) for k, swing in enumerate(swings))
    begun_again = (whole - lowest) % (2 * math.pi) + lowest
    np.testing.assert_allclose(counted_on(begun_again), whole + begun_again[0] - whole[0], atol=1e-9)


def test_what_does_not_start_again_is_left_alone() -> None:
    rng = np.random.default_rng(0)
    knocked = np.append(np.zeros(50), np.full(50, 4.0))
    fast = (2.0 * np.arange(60)) % (2 * math.pi)  # a third of a turn a sample
    beyond = np.where(np.arange(60) % 20 < 10, 0.0, 8.0)
    for angle in (knocked, fast, beyond, rng.normal(size=60), np.zeros(3)):
        np.testing.assert_array_equal(counted_on(angle), angle)


def test_turns_are_counted_on_and_noted(tmp_path: Path, model: mujoco.MjModel) -> None:
    columns = run(2000)
    whole = math.pi + 4 * np.sin(2 * columns["time"])
    begun_again = columns | {"pole": np.degrees(whole % (2 * math.pi))}
    read_again = read(save(tmp_path / "r.csv", table(begun_again)), model, units={"pole": "deg"})
    np.testing.assert_allclose(read_again.sensors[:, 1], whole, atol=1e-9)
    assert "sensor 'pole' starts again after a turn, 5 times; turns are counted on" in read_again.notes


BOTH = RIG.replace(
    '<jointpos name="pole" joint="pole"/>',
    '<jointpos name="pole" joint="pole"/>'
    '<jointvel name="pole_rate" joint="pole"/><jointvel name="speed" joint="cart"/>',
)


def test_velocities_that_are_not_rates_are_noted(tmp_path: Path) -> None:
    model, rng = mjcf.compile(BOTH), np.random.default_rng(0)
    columns = run(4000)
    time, pole, cart = columns["time"], columns["pole"] + 0.2 * np.sin(3 * columns["time"]), columns["cart"]
    rate = np.gradient(pole, time) + 0.05 * rng.normal(size=len(time))
    speed = 1.1 * np.gradient(cart, time) + 0.02  # a gain and a bias are for the diagnosis
    right = columns | {"pole": pole, "pole_rate": rate, "speed": speed}

    def said(**changed: np.ndarray) -> str:
        return " / ".join(read(save(tmp_path / "r.csv", table(right | changed)), model).notes)

    assert said() == ""
    assert "'pole' is the rate of sensor 'pole_rate': interchanged?" in said(pole=rate, pole_rate=pole)
    assert "'pole_rate', integrated, goes -1 times the way of sensor 'pole': its sign is" in said(pole_rate=-rate)
    assert "goes 57.3 times the way of sensor 'pole': check its unit" in said(pole_rate=np.degrees(rate))
    both = said(pole_rate=speed, speed=rate)
    assert "'pole_rate' is not the rate of sensor 'pole'" in both
    assert "'speed' is not the rate of sensor 'cart'" in both
    # A locked joint does not move, and only its noise shows.
    assert "rate" not in said(cart=1e-4 * rng.normal(size=len(time)), speed=1e-2 * rng.normal(size=len(time)))


def test_odd_sampling_is_noted(tmp_path: Path, model: mujoco.MjModel) -> None:
    time = run(2000)["time"]
    rng = np.random.default_rng(3)
    assert "sampling is irregular" in noted(tmp_path, model, time=time + rng.uniform(0, 0.001, 2000))
    gap = np.where(time > 1.0, time + 0.5, time)
    assert "1 gaps in time, the longest 0.502 s after 1 s" in noted(tmp_path, model, time=gap)


# Noise


def sensed(values: np.ndarray, time: np.ndarray) -> Recording:
    return Recording("r", time, np.zeros((len(time), 0)), values[:, None], (), ("s",))


@pytest.mark.parametrize("jitter", [0.0, 0.4])
@pytest.mark.parametrize("sigma", [1e-6, 1e-4, 1e-2])
def test_noise_of_a_known_size_is_found_under_motion(sigma: float, jitter: float) -> None:
    rng = np.random.default_rng(11)
    time = 0.002 * (np.arange(10_000) + jitter * rng.uniform(-1, 1, 10_000))
    motion = 0.2 * np.sin(2 * np.pi * (0.3 * time + 0.2 * time**2 / 2))  # swept to 4 Hz
    estimate = noise(sensed(motion + sigma * rng.normal(size=10_000), time))
    assert estimate[0] == pytest.approx(sigma, rel=0.05)


def test_impacts_do_not_count_as_noise() -> None:
    rng = np.random.default_rng(2)
    time = 0.002 * np.arange(10_000)
    zigzag = 0.05 * np.abs((2 * time) % 2 - 1)  # velocity jumps by 0.2 m/s, forty times
    assert noise(sensed(zigzag + 1e-6 * rng.normal(size=10_000), time))[0] == pytest.approx(1e-6, rel=0.05)


def test_a_coarse_encoder_has_at_least_its_step() -> None:
    time = 0.002 * np.arange(10_000)
    step = 2 * np.pi / 4096
    moving = np.round(0.5 * np.sin(3 * time) / step) * step
    assert noise(sensed(moving, time))[0] == pytest.approx(step / math.sqrt(12), rel=0.15)
    resting = np.where(time < 15, 0.0, moving)
    assert noise(sensed(resting, time))[0] == pytest.approx(step / math.sqrt(12), rel=1e-3)
    assert quantum(resting) == pytest.approx(step)


def test_noise_and_steps_add_up() -> None:
    rng = np.random.default_rng(5)
    time = 0.002 * np.arange(10_000)
    step, sigma = 2e-5, 1e-5
    clean = 0.1 * np.sin(3 * time)
    values = np.round((clean + sigma * rng.normal(size=10_000)) / step) * step
    assert noise(sensed(values, time))[0] == pytest.approx(math.hypot(sigma, step / math.sqrt(12)), rel=0.05)
    assert quantum(values) == pytest.approx(step)


def test_noise_needs_some_samples() -> None:
    time = 0.01 * np.arange(10)
    smooth = np.sin(9 * time)
    assert noise(sensed(smooth, time))[0] < 1e-6
    with pytest.raises(RecordingError, match="9 samples are too few"):
        noise(sensed(smooth, time).slice(0, 9))


def test_of_a_dead_sensor_nothing_is_known() -> None:
    assert noise(sensed(np.full(50, 0.3), 0.01 * np.arange(50))).tolist() == [math.inf]


@pytest.mark.parametrize(
    ("places", "sensor", "low", "high"),
    [
        ("recordings/emps/*.csv", 0, 5e-8 / math.sqrt(12), 5e-8),  # its encoder resolves 5e-8 m
        ("recordings/bam_xl330/*.csv", 0, 0.99 * 2 * math.pi / 4096 / math.sqrt(12), 2 * math.pi / 4096),
        ("practice/*/*.csv", 0, 2e-5 / math.sqrt(12), 2e-5),
        ("practice/p0[47]*/*.csv", 1, 0.99 * 2 * math.pi / 8192 / math.sqrt(12), 2 * math.pi / 8192),
    ],
)
def test_real_sensors_are_as_fine_as_their_makers_say(places: str, sensor: int, low: float, high: float) -> None:
    paths = sorted(SHARED.glob(places))
    if not paths:
        pytest.skip("the shared recordings are not here")
    for path in paths:
        recording = read(path, mjcf.compile(path.parent / "nominal.xml"))
        assert low <= noise(recording)[sensor] <= high


# Commands between stamps


@settings(deadline=None)
@given(
    gaps=st.lists(st.floats(1e-3, 1.0), min_size=1, max_size=12),
    steps=st.lists(st.floats(1e-3, 1.0), min_size=1, max_size=30),
    start=st.floats(-1.0, 2.0),
    seed=st.integers(0, 99),
)
def test_commands_are_averaged_as_they_are_held(gaps: list[float], steps: list[float], start: float, seed: int) -> None:
    time = np.cumsum([0.0, *gaps])
    commands = np.random.default_rng(seed).normal(size=(len(time), 2))
    recording = Recording("r", time, commands, np.zeros((len(time), 0)), ("a", "b"), ())
    grid = start + np.cumsum([0.0, *steps])
    apart = np.abs(np.subtract.outer(time, grid))
    assume(not np.any((apart > 0) & (apart <= 2 * ROUNDING * steps[0])))  # such a stamp stands on the edge
    averaged = resample_commands(recording, grid)
    for mean, low, high in zip(averaged, grid[:-1], grid[1:], strict=True):
        # Cut the step at every stamp in it, and add up the pieces.
        cuts = [low, *(stamp for stamp in time if low < stamp < high), high]
        pieces = [(b - a) * commands[max(0, int(np.sum(time <= a)) - 1)] for a, b in itertools.pairwise(cuts)]
        np.testing.assert_allclose(mean, np.sum(pieces, axis=0) / (high - low), rtol=1e-9, atol=1e-12)


def test_a_command_held_over_the_step_stays_exact() -> None:
    recording = Recording("r", np.array([0.0, 1.0]), np.array([[0.1], [0.7]]), np.zeros((2, 0)), ("a",), ())
    averaged = resample_commands(recording, np.array([-0.5, -0.25, 0.2, 0.5, 0.9, 1.1, 3.0]))
    assert averaged[[0, 1, 2, 3, 5], 0].tolist() == [0.1, 0.1, 0.1, 0.1, 0.7]
    assert averaged[4, 0] == pytest.approx(0.4)
    with pytest.raises(RecordingError, match="two borders that increase"):
        resample_commands(recording, [0.0, 0.0])


def test_every_shared_recording_can_be_read() -> None:
    paths = sorted(SHARED.glob("*/*/*.csv"))
    if not paths:
        pytest.skip("the shared recordings are not here")
    for path in paths:
        model = mjcf.compile(path.parent / "nominal.xml")
        mjcf.check_supported(model, "rig.xml")
        (recording,) = recordings.read_all([path], model)
        assert np.all(np.isfinite(noise(recording)))
        assert not any("clipped" in note or "--unit" in note for note in recording.notes)


def test_a_unit_is_given_once(tmp_path: Path, model: mujoco.MjModel) -> None:
    path = save(tmp_path / "r.csv", table({name: np.arange(30.0) for name in ("time", "motor", "cart", "angle")}))
    units = {"angle": "deg", "pole": "rad"}
    assert "whose unit is given by another name already" in refused(path, model, mapping={"angle": "pole"}, units=units)


def test_a_name_as_long_as_a_models_may_be_is_written_and_read(tmp_path: Path) -> None:
    name = "n" * 200
    text = f"""<mujoco><worldbody><body><joint name="j"/><geom size=".1"/></body></worldbody>
        <actuator><motor name="{name}" joint="j"/></actuator>
        <sensor><jointpos name="{name}" joint="j"/></sensor></mujoco>"""
    time = np.arange(30) * 0.01
    run = Recording("r", time, time[:, None], time[:, None], (name,), (name,))
    again = read(write(run, tmp_path / "r.csv"), mujoco.MjModel.from_xml_string(text))
    np.testing.assert_array_equal(again.sensors, run.sensors)


def test_a_gap_is_told_by_the_time_since_the_first_sample(tmp_path: Path, model: mujoco.MjModel) -> None:
    time = 1000 + np.delete(np.arange(400) * 0.005, slice(200, 240))
    columns = {"time": time, "motor": np.sin(time), "cart": np.sin(3 * time), "pole": np.cos(time)}
    found = read(save(tmp_path / "r.csv", table(columns)), model)
    assert any("s after 0.995 s of recording" in note for note in found.notes)


def test_npz_of_small_numbers_unfolds_into_no_more_either(
    tmp_path: Path, model: mujoco.MjModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A byte in the file is eight of memory."""
    columns = {**run(), **{name: np.zeros(200, dtype=np.int8) for name in ("motor", "cart")}}
    path = npz(tmp_path / "r.npz", **columns)
    read(path, model)
    monkeypatch.setattr("dipc_gym.recording.tables.MAX_VALUES", 799)
    assert "too many; split" in refused(path, model)


@pytest.mark.parametrize("rows", [2, 5, 10])
@pytest.mark.parametrize("count", [0.0, 2 * np.pi / 4096])
def test_readings_that_are_made_up_between_others_are_noted(rows: int, count: float, model: mujoco.MjModel) -> None:
    """Held from one reading to the next, or on a line; as a joint is that is read each row, nothing is said."""
    time = 0.002 * np.arange(4000)
    swing = 0.4 * np.sin(2.1 * time) + 0.3 * np.sin(7.3 * time) + np.random.default_rng(0).normal(0, 1e-4, len(time))
    if count:
        swing = np.round(swing / count) * count
    held = swing[np.arange(len(time)) // rows * rows]
    line = np.interp(time, time[::rows], swing[::rows])

    def said(pole: np.ndarray) -> str:
        whole = {**run(), "time": time, "motor": np.sin(5 * time), "cart": 0.1 * np.sin(3 * time), "pole": pole}
        names = ("cart", "pole")
        made = Recording(
            "made up", time, whole["motor"][:, None], np.stack([whole[n] for n in names], 1), ["motor"], names
        )
        return " ".join(notes(made, model))

    assert "rows" not in said(swing)
    assert f"sensor 'pole' changes only every {rows} rows: it was read at {500 / rows:g} Hz" in said(held)
    if rows > 2:
        assert f"sensor 'pole' lies on straight lines over {rows} rows each" in said(line)


# Angles in degrees of a joint that may turn as often as it likes, beside one that may not


def test_angles_are_all_in_degrees_where_the_motion_fits_the_model_only_then() -> None:
    """An arm about a vertical axis may turn as it likes; the pendulum on it would, read in radians, not move so."""
    model = mjcf.compile(
        """<mujoco><option timestep="0.001" integrator="RK4"/><worldbody>
        <body><joint name="arm" axis="0 0 1" damping="1e-3"/>
          <inertial pos="0.1 0 0" mass="0.2" diaginertia="1e-4 1e-3 1e-3"/>
          <body pos="0.2 0 0"><joint name="pole" axis="1 0 0" damping="1e-4"/>
            <inertial pos="0 0 -0.15" mass="0.1" diaginertia="2e-4 2e-4 1e-5"/></body></body></worldbody>
        <actuator><motor name="motor" joint="arm"/></actuator>
        <sensor><jointpos name="arm" joint="arm"/><jointpos name="pole" joint="pole"/></sensor></mujoco>"""
    )
    data, recorder = mujoco.MjData(model), Recorder(["motor"], ["arm", "pole"])
    for k in range(8000):
        data.ctrl[0] = 0.06 * (np.sin(0.009 * k) + np.sign(np.sin(0.004 * k)))
        if k % 4 == 0:
            recorder.append(data.time, data.ctrl, np.degrees(data.sensordata))
        mujoco.mj_step(model, data)
    run = recorder.recording("run")
    with pytest.raises(RecordingError, match=r"sensor 'arm' reaches .* and sensor 'pole' reaches .* --unit pole=deg"):
        refuse_degrees([run], model)
    assert look_like_degrees(replace(run, sensors=np.radians(run.sensors)), model) == []


@pytest.mark.parametrize("limits", ["", 'limited="true" range="-0.6 0.6"'])
def test_ways_in_millimetres_are_refused_with_what_to_say(limits: str) -> None:
    """Unless that is told; nor is a train taken for a toy that goes that far."""
    model = mjcf.compile(
        f"""<mujoco><option timestep="0.001"/><worldbody><body><joint name="x" type="slide" damping="4" {limits}/>
        <inertial pos="0 0 0" mass="2" diaginertia="1 1 1"/></body></worldbody>
        <actuator><motor name="motor" joint="x"/></actuator>
        <sensor><jointpos name="x" joint="x"/></sensor></mujoco>"""
    )

    def driven(force: float, seconds: float) -> Recording:
        data, recorder, noise = mujoco.MjData(model), Recorder(["motor"], ["x"]), np.random.default_rng(0)
        for k in range(int(1000 * seconds)):
            data.ctrl[0] = force * np.sign(np.sin(2 * np.pi * k * 1e-3 / seconds))
            if k % 10 == 0:
                recorder.append(data.time, data.ctrl, data.sensordata + 2e-4 * noise.normal(size=1))
            mujoco.mj_step(model, data)
        return recorder.recording("run")

    run = driven(2.0, 2.0)
    refuse_millimetres([run], model)
    wrong = replace(run, sensors=1e3 * run.sensors)
    with pytest.raises(RecordingError, match=r"sensor 'x' reaches .* m, which looks like millimetres; say --unit x=mm"):
        refuse_millimetres([wrong], model)
    refuse_millimetres([replace(wrong, told=("x",))], model)
    if not limits:
        far = driven(50.0, 20.0)
        assert np.ptp(far.sensors) > 50
        refuse_millimetres([far], model)


def test_a_glitch_and_a_gap_leave_turns_counted_on() -> None:
    turning = np.linspace(0.0, 30.0, 3000)
    turning[1500:] += 2.0  # samples that are missing
    begun_again = (turning + np.pi) % (2 * np.pi) - np.pi
    begun_again[700] -= 2.5
    on = counted_on(begun_again)
    assert on[700] == pytest.approx(turning[700] - 2.5)
    np.testing.assert_allclose(np.delete(on, 700), np.delete(turning, 700), atol=1e-9)


def test_stamps_that_are_rounded_are_not_repeated_rows(tmp_path: Path, model: mujoco.MjModel) -> None:
    """Dropped, every other sample would be missing, and the rest off by as much."""
    time = np.floor(np.arange(60) / 2.5) / 100
    said = refused(save(tmp_path / "r.csv", table({**run(60), "time": time})), model)
    assert "only rounded stamps repeat so often: write more digits" in said
