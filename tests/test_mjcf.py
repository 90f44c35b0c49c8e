"""Reading models: what is refused before compilation, what the limits stop, and what a model commands and senses."""

import os
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dipc_gym import mjcf
from dipc_gym.mjcf import source
from dipc_gym.mjcf.scan import scan

BODY = '<body><joint name="j" type="slide"/><geom type="mesh" mesh="t"/></body>'
MESH = f'<asset><mesh name="t" file="{{}}"/></asset><worldbody>{BODY}</worldbody>'
TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
MASS = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
RIG = f"""<mujoco>
  <worldbody>
    <body name="cart">{MASS}<joint name="cart" type="slide" axis="1 0 0"/>{{inside}}</body>
    {{beside}}
  </worldbody>
  {{more}}
  <sensor><jointpos name="cart" joint="cart"/></sensor>
</mujoco>"""


def rig(inside: str = "", beside: str = "", more: str = "") -> str:
    return RIG.format(inside=inside, beside=beside, more=more)


def mesh_model(file: str, compiler: str = "") -> str:
    return f"<mujoco>{compiler}{MESH.format(file)}</mujoco>"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A model's folder with meshes and sub-models, and a file beside it that no model may read."""
    model = tmp_path / "model"
    for place in ("meshes/deep", "sub/meshes"):
        (model / place).mkdir(parents=True)
    for mesh in ("meshes/t.obj", "meshes/deep/t.obj", "sub/meshes/t.obj", "../secret.obj"):
        (model / mesh).write_text(TETRAHEDRON)
    (model / "option.xml").write_text('<mujoco><option timestep="0.0007"/></mujoco>')
    (model / "sub/option.xml").write_text('<mujoco><option timestep="0.0009"/></mujoco>')
    submodel = f'<mujoco><compiler meshdir="meshes"/><include file="option.xml"/>{MESH.format("t.obj")}</mujoco>'
    (model / "sub/m.xml").write_text(submodel.replace("<body>", '<body name="b">'))
    return model


def refused(source: object) -> str:
    with pytest.raises(mjcf.MjcfError) as caught:
        mjcf.compile(source)  # type: ignore[arg-type]
    return str(caught.value)


# What compiles, compiles as MuJoCo would have


@pytest.mark.parametrize(
    "text",
    [
        mesh_model("meshes/t.obj"),
        mesh_model("./t.obj", '<compiler meshdir="meshes/"/>'),
        mesh_model("../t.obj", '<compiler meshdir="meshes/deep"/>'),
        mesh_model("nowhere/t.obj", '<compiler meshdir="meshes" strippath="true"/>'),
        mesh_model("t.obj", '<compiler meshdir="nowhere"/><compiler meshdir="meshes"/>'),
        mesh_model("t.obj", '<compiler meshdir="nowhere"/><compiler assetdir="meshes"/>'),
        mesh_model("meshes\\t.obj"),
        mesh_model("meshes/t.obj", '<include file="sub/option.xml"/>'),
        '<mujoco><asset><model name="s" file="sub/m.xml"/></asset>'
        '<worldbody><attach model="s" body="b" prefix="p"/></worldbody></mujoco>',
        '<mujoco><worldbody><flexcomp name="f" type="mesh" dim="2" file="meshes/t.obj" radius="0.01" mass="1"/>'
        "</worldbody></mujoco>",
    ],
)
def test_files_are_found_where_mujoco_finds_them(folder: Path, text: str) -> None:
    (folder / "main.xml").write_text(text)
    mjcf.quiet_mujoco()
    expected = mujoco.MjModel.from_xml_path(str(folder / "main.xml"))
    model = mjcf.compile(folder / "main.xml")
    assert (model.nq, model.nmesh, model.nflex) == (expected.nq, expected.nmesh, expected.nflex)
    np.testing.assert_array_equal(model.mesh_vert, expected.mesh_vert)
    assert model.opt.timestep == expected.opt.timestep


def test_what_was_scanned_is_what_is_compiled(folder: Path) -> None:
    (folder / "main.xml").write_text(mesh_model("meshes/t.obj", '<include file="option.xml"/>'))
    source = mjcf.read(folder / "main.xml")
    (folder / "option.xml").write_text('<mujoco><option timestep="0.5"/></mujoco>')
    (folder / "meshes/t.obj").unlink()
    assert mjcf.compile(source, trusted=True).opt.timestep == 0.0007


def test_from_text_looks_in_the_folder_it_is_given(folder: Path) -> None:
    source = mjcf.from_text(mesh_model("meshes/t.obj"), folder)
    assert source.path is None
    assert mjcf.compile(source).nmesh == 1


def test_an_edited_source_is_scanned_again_unless_it_is_trusted(folder: Path) -> None:
    (folder / "main.xml").write_text(mesh_model("meshes/t.obj"))
    source = mjcf.read(folder / "main.xml")
    assert "leads out" in refused(source.edited(mesh_model("../secret.obj")))
    edited = source.edited(source.text.replace("<mujoco>", '<mujoco><option timestep="0.004"/>'))
    assert mjcf.compile(edited, trusted=True).opt.timestep == 0.004


# What the scan refuses


@pytest.mark.parametrize(
    "text",
    [
        mesh_model("../secret.obj"),
        mesh_model("meshes/../../secret.obj"),
        mesh_model("..\\secret.obj"),
        mesh_model("secret.obj", '<compiler meshdir=".."/>'),
        mesh_model("secret.obj", '<compiler assetdir="meshes/../.."/>'),
        mesh_model("{folder}/../secret.obj"),
        mesh_model("secret.obj", '<compiler meshdir="{folder}/.."/>'),
        mesh_model("linked.obj"),
        mesh_model("x" * 300 + ".obj"),
        mesh_model("t.obj", '<compiler meshdir="linked"/>'),
        "<mujoco><include file='../secret.obj'/></mujoco>",
        "<mujoco><include file='/etc/passwd'/></mujoco>",
        '<mujoco><asset><model name="s" file="../secret.obj"/></asset></mujoco>',
        '<mujoco><asset><hfield name="h" file="../secret.obj" size="1 1 1 1"/></asset></mujoco>',
        '<mujoco><asset><texture type="cube" fileup="../secret.png"/></asset></mujoco>',
        '<mujoco><compiler texturedir=".."/><asset><texture type="2d" name="t" file="secret.png"/></asset></mujoco>',
        '<mujoco><deformable><skin file="../secret.skn"/></deformable></mujoco>',
        '<mujoco><worldbody><flexcomp name="f" type="mesh" file="../secret.obj"/></worldbody></mujoco>',
        mesh_model("C:/secret.obj"),
        mesh_model("http://example.org/t.obj"),
    ],
)
def test_files_outside_the_folder_are_refused(folder: Path, text: str) -> None:
    (folder / "linked.obj").symlink_to(folder / "../secret.obj")
    (folder / "linked").symlink_to(folder.parent)
    (folder.parent / "t.obj").write_text(TETRAHEDRON)
    (folder / "main.xml").write_text(text.replace("{folder}", str(folder)))
    message = refused(folder / "main.xml")
    assert "main.xml, line 1, <" in message
    assert "leads out of the model's folder" in message or "not a path inside" in message


def test_a_submodel_may_not_leave_the_folder_either(folder: Path) -> None:
    (folder / "sub/m.xml").write_text(mesh_model("../../secret.obj"))
    (folder / "main.xml").write_text('<mujoco><asset><model name="s" file="sub/m.xml"/></asset></mujoco>')
    message = refused(folder / "main.xml")
    assert "main.xml -> sub/m.xml, line 1, <mesh>" in message
    assert "leads out" in message


def test_a_missing_file_is_named_with_its_line(folder: Path) -> None:
    (folder / "main.xml").write_text("<mujoco>\n\n" + MESH.format("meshes/none.obj") + "</mujoco>")
    assert "main.xml, line 3, <mesh>: file 'meshes/none.obj' is not in" in refused(folder / "main.xml")


def test_a_pipe_is_not_read(folder: Path) -> None:
    os.mkfifo(folder / "pipe.obj")
    (folder / "main.xml").write_text(mesh_model("pipe.obj"))
    assert "file 'pipe.obj' is not in" in refused(folder / "main.xml")


def test_circles_are_refused(folder: Path) -> None:
    (folder / "a.xml").write_text("<mujoco><include file='b.xml'/></mujoco>")
    (folder / "b.xml").write_text("<mujoco><include file='a.xml'/></mujoco>")
    assert "contains itself" in refused(folder / "a.xml")
    (folder / "m.xml").write_text('<mujoco><asset><model name="s" file="m.xml"/></asset></mujoco>')
    assert "contains itself" in refused(folder / "m.xml")


def test_what_is_included_too_deep_is_refused(folder: Path) -> None:
    for level in range(400):
        (folder / f"l{level}.xml").write_text(f"<mujoco><include file='l{level + 1}.xml'/></mujoco>")
    assert "50 files deep" in refused(folder / "l0.xml")


def test_elements_that_stand_too_deep_in_each_other_are_refused_across_files(folder: Path) -> None:
    """Each file by itself is shallow enough for MuJoCo; what reads them all one in the other would not come back."""
    for level, inner in enumerate(("<include file='d1.xml'/>", "<include file='d2.xml'/>", "<body/>")):
        outer = "mujocoinclude" if level else "mujoco"
        nested = "<frame>" * 120 + inner + "</frame>" * 120
        (folder / f"d{level}.xml").write_text(f"<{outer}><worldbody>{nested}</worldbody></{outer}>")
    assert "may stand 300 deep in each other" in refused(folder / "d0.xml")


def test_repeated_submodels_run_into_the_limit_and_not_into_the_night(folder: Path) -> None:
    for level in range(12):
        models = "".join(f'<model name="m{k}" file="l{level + 1}.xml"/>' for k in range(10))
        (folder / f"l{level}.xml").write_text(f"<mujoco><asset>{models}</asset></mujoco>")
    (folder / "l12.xml").write_text("<mujoco/>")
    assert "multiplies into more than 100,000 elements" in refused(folder / "l0.xml")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('<!DOCTYPE m [<!ENTITY a "aaa"><!ENTITY b "&a;&a;">]>\n<mujoco model="&b;"/>', "remove the <!DOCTYPE"),
        ('<!DOCTYPE m SYSTEM "file:///etc/passwd">\n<mujoco/>', "remove the <!DOCTYPE"),
        ("<mujoco>\n<worldbody>\n</mujoco>", "line 3: mismatched tag"),
        ("<mujoco>\0</mujoco>", "not well-formed"),
        ("<mujoco model='\ud800'/>", "characters that UTF-8 does not have"),
        ("<robot name='r'/>", "must be <mujoco>"),
        ("<", "line 1"),
        (f'<mujoco><worldbody><replicate count="1e8"><body>{MASS}</body></replicate></worldbody></mujoco>', "multipl"),
        (
            "<mujoco><worldbody>"
            + '<replicate count="90">' * 4
            + "<site/>"
            + "</replicate>" * 4
            + "</worldbody></mujoco>",
            "multiplies into more than 100,000",
        ),
        ('<mujoco><worldbody><replicate count="many"/></worldbody></mujoco>', "count 'many' is not a number"),
        ('<mujoco><worldbody><composite count="1000 1000 1"/></worldbody></mujoco>', "multiplies"),
        (f'<mujoco><worldbody><body name="{201 * "y"}"/></worldbody></mujoco>', "<body>: its name has more than 200"),
        ('<mujoco><worldbody><flexcomp name="f" count="999 999 999"/></worldbody></mujoco>', "multiplies"),
    ],
)
def test_the_scan_refuses(text: str, said: str) -> None:
    with pytest.raises(mjcf.MjcfError, match="MJCF text") as caught:
        mjcf.from_text(text)
    assert said in str(caught.value)


def test_files_that_are_not_models(tmp_path: Path) -> None:
    assert "no such model file" in refused(tmp_path / "none.xml")
    assert "no such model file" in refused(tmp_path)
    (tmp_path / "binary.xml").write_bytes(b"\x89PNG\xff\xfe")
    assert "not UTF-8 text at byte 0" in refused(tmp_path / "binary.xml")
    (tmp_path / "empty.xml").write_text("")
    assert "no element found" in refused(tmp_path / "empty.xml")
    with (tmp_path / "huge.xml").open("wb") as huge:
        huge.truncate(30_000_000)
    assert "too large" in refused(tmp_path / "huge.xml")


def test_a_byte_order_mark_does_no_harm(tmp_path: Path) -> None:
    (tmp_path / "m.xml").write_bytes(b"\xef\xbb\xbf" + rig().encode())
    assert mjcf.compile(tmp_path / "m.xml").nv == 1


PIECES = st.sampled_from(
    ["<mujoco>", "</mujoco>", "<include file='", "option.xml", "../x", "'/>", "<replicate count='", "9", "1e9", "\0"]
) | st.sampled_from(
    ["<!--", "-->", "<![CDATA[", "]]>", "<!DOCTYPE a>", "&lt;", "é", "<asset>", "</asset>", "<mesh file='", "<body>"]
)


@settings(deadline=None)
@given(st.lists(PIECES, max_size=20).map("".join) | st.text(max_size=60))
def test_whatever_the_text_the_scan_raises_nothing_else(text: str) -> None:
    try:
        files = scan(text, "text", Path("nowhere"))
    except mjcf.MjcfError:
        return
    assert files == {}


# What the trial compilation refuses


@pytest.mark.parametrize(
    "more",
    [
        '<asset><texture name="t" type="2d" builtin="flat" width="60000" height="60000"/></asset>',
        '<asset><hfield name="h" nrow="100000" ncol="100000" size="1 1 1 1"/></asset>',
        '<size memory="100G"/>',
        '<size nuser_body="2000000000"/>',
    ],
)
def test_greedy_models_die_in_the_child(more: str) -> None:
    assert "memory" in refused(rig(more=more))


def test_time_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(source, "CPU_LIMIT", 1)
    bodies = f'<worldbody><replicate count="20000"><body>{MASS}<joint/></body></replicate></worldbody>'
    assert "within 1 s of computing" in refused(f"<mujoco>{bodies}</mujoco>")


def test_mujocos_own_message_comes_through(tmp_path: Path) -> None:
    path = tmp_path / "bad.xml"
    path.write_text("<mujoco>\n<worldbody>\n<body><jiont/></body></worldbody></mujoco>")
    message = refused(path)
    assert "bad.xml: XML Error" in message
    assert "jiont" in message
    assert "line 3" in message
    assert "\n" not in message


def test_the_child_runs_once_per_content(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []
    monkeypatch.setattr(source, "_try_in_child", calls.append)
    text = rig(more='<option timestep="0.00123"/>')
    mjcf.compile(text)
    mjcf.compile(text)
    mjcf.compile(mjcf.from_text(text))
    assert len(calls) == 1
    mjcf.compile(mjcf.from_text(text.replace("0.00123", "0.00124")), trusted=True)
    assert len(calls) == 1


def test_mujoco_leaves_no_log_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: object) -> None:
    monkeypatch.chdir(tmp_path)
    model = mjcf.compile(rig())
    data = mujoco.MjData(model)
    data.qpos[0] = np.nan
    mujoco.mj_step(model, data)
    assert data.warning[mujoco.mjtWarning.mjWARN_BADQPOS].number == 1
    assert not list(tmp_path.iterdir())
    assert capfd.readouterr() == ("", "")  # type: ignore[attr-defined]


# What a model commands and senses


def test_controls_are_counted_by_mujoco_and_not_by_actuators() -> None:
    model = mjcf.compile(
        rig(
            more="""<actuator>
              <dcmotor name="friction" joint="cart" input="none" motorconst="0" resistance="1"/>
              <pid name="servo" joint="cart" input="pos vel ff"/>
              <motor name="motor" joint="cart"/>
            </actuator>"""
        )
    )
    names = mjcf.controls(model)
    assert names == ["servo.pos", "servo.vel", "servo.ff", "motor"]
    assert len(names) == model.nu
    data = mujoco.MjData(model)
    data.ctrl[names.index("motor")] = 2.0
    mujoco.mj_forward(model, data)
    assert data.qacc[0] == pytest.approx(2.0)


def test_an_actuator_without_a_name_is_refused() -> None:
    model = mjcf.compile(rig(more='<actuator><motor joint="cart"/></actuator>'))
    with pytest.raises(mjcf.MjcfError, match=r"^actuator 0 has no name"):
        mjcf.controls(model)
    with pytest.raises(mjcf.MjcfError, match=r"^mine\.xml: actuator 0 has no name"):
        mjcf.check_supported(model, "mine.xml")


def test_a_recording_in_the_place_of_the_model_is_told(tmp_path: Path) -> None:
    (tmp_path / "run_1.csv").write_text("time,motor\n0,1\n")
    with pytest.raises(mjcf.MjcfError, match=r"run_1\.csv: is no MJCF .* the model comes first, then recordings"):
        mjcf.read(tmp_path / "run_1.csv")


def test_scalar_sensors_leave_out_vectors_and_the_unnamed() -> None:
    text = rig().replace(
        "<sensor>",
        '<sensor><framepos name="place" objtype="body" objname="cart"/><jointvel joint="cart"/>'
        '<jointvel name="speed" joint="cart"/>',
    )
    model = mjcf.compile(text)
    assert mjcf.scalar_sensors(model) == ["speed", "cart"]
    data = mujoco.MjData(model)
    data.qpos[0], data.qvel[0] = 0.25, -3.0
    mujoco.mj_forward(model, data)
    np.testing.assert_array_equal(data.sensordata[mjcf.sensor_addresses(model)], [-3.0, 0.25])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (rig(beside=f"<body><freejoint name='f'/>{MASS}</body>"), "joint 'f' is a free joint"),
        (rig(inside=f"<body><joint type='ball'/>{MASS}</body>"), "joint number 1 is a ball joint"),
        (rig(beside="<flexcomp name='f' type='grid' count='3 3 1' spacing='.1 .1 .1' dim='2' mass='1'/>"), "flex"),
        ("<mujoco/>", "no joints"),
        (rig(inside="<geom name='a' size='1'/>", beside="<geom size='1'/>"), "can touch"),
    ],
)
def test_what_is_not_supported_is_said(text: str, said: str) -> None:
    with pytest.raises(mjcf.MjcfError, match=f"^rig.xml: .*{said}") as caught:
        mjcf.check_supported(mjcf.compile(text), "rig.xml")
    assert "Supported are models with hinge and slide joints" in str(caught.value)


def test_a_sensor_that_holds_its_reading_is_refused() -> None:
    text = f"""<mujoco><worldbody><body><joint name="x"/>{MASS}</body></worldbody>
    <sensor><jointpos name="x" joint="x" nsample="2" interval="0.02"/></sensor></mujoco>"""
    with pytest.raises(mjcf.MjcfError, match=r"^rig.xml: sensor 'x' has an interval, .* Remove it, and record at"):
        mjcf.check_supported(mjcf.compile(text), "rig.xml")


def test_a_model_without_sensors_is_told_which_ones_to_write() -> None:
    """Most models of robots have none; what the message says, put where it says, is what is lacking."""
    text = f"""<mujoco><worldbody><body><joint name="hip" axis="0 1 0"/>{MASS}
    <body><joint name="knee" type="slide" axis="1 0 0"/>{MASS}</body></body></worldbody></mujoco>"""
    with pytest.raises(mjcf.MjcfError, match=r"^leg.xml: .*no named scalar sensor.* before </mujoco>: ") as caught:
        mjcf.check_supported(mjcf.compile(text), "leg.xml")
    lines = str(caught.value).split("</mujoco>: ")[1]
    unnamed = lines.replace('name="hip" ', "").replace('name="knee" ', "")
    with pytest.raises(mjcf.MjcfError, match="no named scalar sensor"):
        mjcf.check_supported(mjcf.compile(text.replace("</mujoco>", f"{unnamed}</mujoco>")), "leg.xml")
    model = mjcf.compile(text.replace("</mujoco>", f"{lines}</mujoco>"))
    mjcf.check_supported(model, "leg.xml")
    assert mjcf.scalar_sensors(model) == ["hip", "knee"]


GEOM = st.tuples(st.integers(0, 3), st.integers(0, 3), st.integers(0, 4))


@settings(deadline=None)
@given(st.lists(GEOM, max_size=5), st.booleans(), st.sampled_from(["enable", "disable"]))
def test_contact_filters_agree_with_mujoco(geoms: list[tuple[int, int, int]], exclude: bool, parents: str) -> None:
    """With all geoms in one place and overlapping, MuJoCo finds a contact exactly where the filters allow one."""
    mjcf.quiet_mujoco()
    spec = mujoco.MjSpec()
    bodies = [spec.worldbody]
    # world -> 1 (moves) -> 2 (moves) -> 3 (welded to 2); 4 (moves) in the world
    for parent, moves in ((0, True), (1, True), (2, False), (0, True)):
        body = bodies[parent].add_body(name=f"b{len(bodies)}", mass=1, inertia=[1, 1, 1], explicitinertial=True)
        if moves:
            body.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE)
        bodies.append(body)
    for number, (kind, affinity, body) in enumerate(geoms):
        place = [0.1 * number, 0, 0]
        bodies[body].add_geom(size=[1, 1, 1], contype=kind, conaffinity=affinity, pos=place)
    if exclude:
        spec.add_exclude(bodyname1="b4", bodyname2="b1")
    model = spec.compile()
    if parents == "disable":
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_FILTERPARENT
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert (mjcf.touching_pair(model) is not None) == (data.ncon > 0)


@pytest.mark.parametrize(
    ("flag", "mend"),
    [("frictionloss", "remove it$"), ("constraint", 'remove it, and write <flag contact="disable"/> for it$')],
)
def test_dry_friction_that_is_switched_off_is_refused(flag: str, mend: str) -> None:
    """Simulators would disagree on it, and what is written back would do nothing."""
    text = rig().replace("<mujoco>", f'<mujoco><option><flag {flag}="disable"/></option>')
    with pytest.raises(mjcf.MjcfError, match=f'^rig.xml: <flag {flag}="disable"/> switches dry friction off.*{mend}'):
        mjcf.check_supported(mjcf.compile(text), "rig.xml")


@pytest.mark.parametrize(("flag", "what"), [("damper", "damping"), ("spring", "springs")])
def test_damping_and_springs_that_are_switched_off_are_refused(flag: str, what: str) -> None:
    text = rig().replace("<mujoco>", f'<mujoco><option><flag {flag}="disable"/></option>')
    with pytest.raises(mjcf.MjcfError, match=f'<flag {flag}="disable"/> switches {what} off.*remove it$'):
        mjcf.check_supported(mjcf.compile(text), "rig.xml")


def test_geoms_by_the_thousand_are_paired_by_what_they_may_touch() -> None:
    """Of a body's geoms that may touch the same, one tells for all."""
    text = rig(inside="<replicate count='2000' offset='0 0 1'><geom size='0.1' mass='1'/></replicate>")
    model = mjcf.compile(text)
    assert model.ngeom >= 2_000
    assert mjcf.touching_pair(model) is None
    touched = rig(
        inside="<replicate count='500' offset='0 0 1'><geom size='0.1' mass='1'/></replicate>",
        beside="<geom name='b' size='1' contype='2' conaffinity='1'/>",
    )
    assert "'b'" in (mjcf.touching_pair(mjcf.compile(touched)) or ())


def test_switched_off_contacts_are_no_contacts() -> None:
    text = rig(inside="<geom size='1'/>", beside="<geom size='1'/>")
    mjcf.check_supported(
        mjcf.compile(text.replace("<mujoco>", '<mujoco><option><flag contact="disable"/></option>')), "rig.xml"
    )
    pair = '<contact><pair geom1="a" geom2="b"/></contact>'
    silent = 'contype="0" conaffinity="0"'
    text = rig(inside=f"<geom name='a' size='1' {silent}/>", beside=f"<geom name='b' size='1' {silent}/>")
    mjcf.check_supported(mjcf.compile(text), "rig.xml")
    with pytest.raises(mjcf.MjcfError, match="geoms 'b' and 'a' can touch"):
        mjcf.check_supported(mjcf.compile(text.replace("<sensor>", pair + "<sensor>")), "rig.xml")


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (('timestep="0.001"', 'timestep="nan"'), "the timestep is nan s"),
        (('timestep="0.001"', 'timestep="1e-300"'), "the timestep is 1e-300 s"),
        (('timestep="0.001"', 'timestep="1e9"'), r"the timestep is 1e\+09 s"),
        (('mass="1"', 'mass="1e-12"'), "joint 'slide' has an inertia of 1e-12"),
        (('damping="0"', 'damping="nan"'), "nan in dof_damping"),
        (('stiffness="0"', 'stiffness="1e200"'), r"1e\+200 in jnt_stiffness"),
        (('gravity="0 0 -9.81"', 'gravity="0 0 nan"'), "nan in <option gravity>"),
    ],
)
def test_numbers_that_nothing_can_be_simulated_with_are_refused(change: tuple[str, str], says: str) -> None:
    text = """<mujoco><option timestep="0.001" gravity="0 0 -9.81"/><worldbody><body>
        <joint name="slide" type="slide" damping="0" stiffness="0"/>
        <geom size="0.1" mass="1"/></body></worldbody></mujoco>"""
    mjcf.compile(text)
    assert text.count(change[0]) == 1
    for _ in range(2):  # what was refused is not let pass the next time
        with pytest.raises(mjcf.MjcfError, match=says):
            mjcf.compile(text.replace(*change))


def test_a_joint_without_inertia_of_its_own_is_refused() -> None:
    """Two slides along one axis with a mass behind the second alone: the first one's pivot is rounding."""
    text = """<mujoco><worldbody><body><inertial pos="0 0 0" mass="1e-14" diaginertia="1e-14 1e-14 1e-14"/>
        <joint name="first" type="slide" axis="1 0 0"/><body>
        <joint name="second" type="slide" axis="1 0 0"/><geom size="0.1" mass="1"/>
        </body></body></worldbody></mujoco>"""
    with pytest.raises(mjcf.MjcfError, match=r"joint '(first|second)' has an inertia of"):
        mjcf.compile(text)
    mjcf.compile(text.replace('mass="1e-14"', 'mass="0.1"'))


@pytest.mark.parametrize("name", ["\x9b31m", "a\u202eb", "&#10;note: all is well", "&#155;2J"])
def test_a_name_that_a_terminal_would_take_orders_from_is_refused(name: str) -> None:
    text = f'<mujoco><worldbody><body><joint name="{name}"/><geom size="1"/></body></worldbody></mujoco>'
    with pytest.raises(mjcf.MjcfError, match="<joint>: its name has characters that cannot be printed") as refused:
        mjcf.compile(text)
    assert str(refused.value).isprintable()
    with pytest.raises(mjcf.MjcfError, match="invalid keyword") as refused:
        mjcf.compile(text.replace("name=", "type="))
    assert str(refused.value).isprintable()


def test_custom_text_without_a_name_is_left_out() -> None:
    named = '<custom><text name="note" data="a"/><text name="" data="b"/></custom>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco>{named}<worldbody/></mujoco>")
    assert model.ntext == 2
    assert mjcf.texts(model) == {"note": "a"}
    assert mjcf.controls(model) == []


def test_an_actuator_that_integrates_is_refused_and_one_that_follows_is_known() -> None:
    body = '<worldbody><body><joint name="x" type="slide"/><geom size="1"/></body></worldbody>'
    sensor = '<sensor><jointpos name="x" joint="x"/></sensor>'
    drives = {
        '<intvelocity name="drive" joint="x" kp="1" actrange="-1 1"/>': None,
        '<general name="drive" joint="x" dyntype="filterexact" dynprm="0.2"/>': 0.2,
        '<cylinder name="drive" joint="x" timeconst="0.05"/>': 0.05,
        '<muscle name="drive" joint="x" lengthrange="0 1" timeconst="0.01 0.04"/>': 0.04,
        '<motor name="drive" joint="x"/>': 0.0,
    }
    for drive, longest in drives.items():
        model = mjcf.compile(f"<mujoco>{body}<actuator>{drive}</actuator>{sensor}</mujoco>")
        if longest is None:
            with pytest.raises(
                mjcf.MjcfError, match="actuator 'drive' integrates its command, and where that has come to"
            ):
                mjcf.check_supported(model, "rig.xml")
            continue
        mjcf.check_supported(model, "rig.xml")
        assert mjcf.slowest_activation(model) == pytest.approx(longest)


# Delays


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast", "RK4"])
@pytest.mark.parametrize("interp", ["zoh", "linear"])
@pytest.mark.parametrize("delay", [0.0, 0.0007, 0.002, 0.0133, 0.014])
def test_how_late_commands_act_is_what_mujoco_makes_of_it(integrator: str, interp: str, delay: float) -> None:
    """The momentum of a mass under a ramp of commands tells, once the history holds it."""
    step, mass = 0.002, 0.5
    model = mjcf.compile(
        f"""<mujoco><option timestep="{step}" integrator="{integrator}" gravity="0 0 0"/><worldbody><body>
        <joint name="x" type="slide"/><inertial pos="0 0 0" mass="{mass}" diaginertia="1 1 1"/></body></worldbody>
        <actuator><motor name="drive" joint="x" delay="{delay}" interp="{interp}" nsample="12"/></actuator></mujoco>"""
    )
    data, momentum = mujoco.MjData(model), []
    for k in range(60):
        data.ctrl[0] = k * step  # held for the step: without delay, this is what acts
        mujoco.mj_step(model, data)
        momentum.append(mass * data.qvel[0])
    acted = (momentum[-1] - momentum[19]) / step  # the sum of what acted in steps 20 to 59
    assert sum(k * step for k in range(20, 60)) - acted == pytest.approx(
        40 * mjcf.control_delays(model, stepped=True)[0], abs=1e-9
    )


@pytest.mark.parametrize("integrator", ["Euler", "RK4"])
@given(delay=st.floats(0.0, 0.05))
def test_a_delay_that_a_file_is_given_is_the_one_that_it_has(integrator: str, delay: float) -> None:
    said = mjcf.with_delay(delay, 0.002, integrator)
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option timestep="0.002" integrator="{integrator}"/><worldbody><body>
        <joint name="x" type="slide"/><geom size="0.1"/></body></worldbody>
        <actuator><motor joint="x" delay="{said}" interp="linear" nsample="40"/></actuator></mujoco>"""
    )
    assert mjcf.control_delays(model)[0] == pytest.approx(delay, abs=1e-12)
