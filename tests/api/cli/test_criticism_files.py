"""A criticism from files: the simulator that options name, and the files that are left."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from adr_service.blind_test.planting import hide
from adr_service.criticism.extension import extend
from adr_service.errors import InvalidInput
from adr_service.progress import silent
from adr_service.tasks.catalogue import get_task
from api.cli.criticism_files import (
    check_differ,
    criticise_files,
    limits_of,
    nominal_of,
    portable,
    reach_of,
    start_of,
    write,
)
from tests.hidden import arm

MASS = "body:upper.mass=0.5:2"


@pytest.fixture
def model(tmp_path):
    """The arm's MJCF as a file."""
    path = tmp_path / "arm.xml"
    path.write_text(get_task("arm").xml)
    return path


def test_a_task_has_its_own_parameters_and_the_variant_in_its_name():
    nominal, name = nominal_of("arm", None, None, [])
    assert name == "arm, vanilla"
    assert len(nominal.space) == 4
    assert nominal_of("arm", "noisy", None, [])[1] == "arm, noisy"


def test_a_model_has_the_free_parameters_that_are_given(model):
    nominal, name = nominal_of(None, None, model, [MASS])
    assert name == "arm.xml"
    (parameter,) = nominal.space.parameters
    assert (parameter.address, parameter.low, parameter.high) == ("body:upper.mass", 0.5, 2.0)
    assert parameter.unit == "kg"


@pytest.mark.parametrize(
    ("task", "variant", "file", "free", "message"),
    [
        (None, None, None, [], "give either --task or --model"),
        ("arm", None, "arm.xml", [], "give either --task or --model"),
        (None, "noisy", "arm.xml", [], "--variant goes with --task"),
        ("arm", None, None, [MASS], "--free goes with --model"),
        (None, None, "nowhere.xml", [], "nowhere.xml cannot be read: it is no file"),
        (None, None, "arm.xml", ["mass"], r"--free 'mass' is not ADDRESS=LOW:HIGH"),
        (None, None, "arm.xml", ["mass=1"], r"--free 'mass=1' is not ADDRESS=LOW:HIGH"),
        (
            None,
            None,
            "arm.xml",
            [MASS.replace("2", "0.5")],
            "needs finite bounds, the lower one first",
        ),
        (
            None,
            None,
            "arm.xml",
            [MASS.replace("2", "inf")],
            "needs finite bounds, the lower one first",
        ),
    ],
)
def test_other_options_are_refused(model, task, variant, file, free, message):
    path = None if file is None else model.parent / file
    with pytest.raises(InvalidInput, match=message):
        nominal_of(task, variant, path, free)


@pytest.mark.parametrize(
    ("read", "texts"),
    [
        (limits_of, ["shoulder=-0.2:0.2", "shoulder=-1:1"]),
        (reach_of, ["shoulder=-1:1", "elbow=0:1", "shoulder=0:1"]),
        (start_of, ["shoulder=0.1", "shoulder=0.2"]),
    ],
)
def test_a_name_that_is_given_twice_is_refused(read, texts):
    """The last one won, and commands went beyond the limit that was meant."""
    nominal, _ = nominal_of("arm", None, None, [])
    with pytest.raises(InvalidInput, match=r"--(limit|reach|start) has shoulder 2 times"):
        read(texts, nominal)
    assert list(read(texts[:1], nominal)) == [0]


def test_a_reach_beyond_the_joints_range_is_refused_with_its_unit(model):
    """Degrees that were taken for radians left a robot's plan without a bound."""
    limited = '<joint name="elbow" limited="true" range="-1.5 1.5"'
    model.write_text(model.read_text().replace('<joint name="elbow"', limited))
    nominal, _ = nominal_of(None, None, model, [])
    assert reach_of(["elbow=-1:1.5"], nominal) == {1: (-1.0, 1.5)}
    low, high = nominal.model(nominal.start).joint("elbow").range
    assert reach_of([f"elbow={low:.4g}:{high:.4g}"], nominal)  # as the message has them
    message = f"--reach elbow: given -90; the joint may be at {low:.4g} to {high:.4g} rad$"
    with pytest.raises(InvalidInput, match=message):
        reach_of(["elbow=-90:90"], nominal)


def test_a_file_that_is_no_model_is_refused(tmp_path):
    path = tmp_path / "letter.xml"
    path.write_text("dear robot")
    words = r"letter\.xml is no MJCF or URDF that MuJoCo can read; it says: XML parse error [^\n]*$"
    with pytest.raises(InvalidInput, match=words):
        nominal_of(None, None, path, [])
    path.write_text("<mujoco><asset><mesh file='none.stl'/></asset></mujoco>")
    with pytest.raises(InvalidInput, match=r"letter\.xml.*none\.stl"):
        nominal_of(None, None, path, [])


@pytest.mark.parametrize(("name", "content"), [("m.npz", b"dear robot"), ("m.csv", b"\xff")])
@pytest.mark.parametrize("task", [True, False])
def test_a_file_that_is_no_measurement_is_named(model, tmp_path, name, content, task):
    nominal, _ = nominal_of("arm", None, None, []) if task else nominal_of(None, None, model, [])
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InvalidInput, match=rf"{name}: .+"):
        criticise_files(nominal, "arm", [tmp_path / name], tmp_path, 0, silent)


def test_files_are_written_into_a_new_folder(tmp_path):
    out = tmp_path / "a" / "b"
    write(out, {"verdict.json": b"{}"})
    assert [(path.name, path.read_bytes()) for path in out.iterdir()] == [("verdict.json", b"{}")]


@pytest.mark.parametrize("name", ["nowhere.npz", "nowhere.csv"])
def test_a_measurement_that_cannot_be_read_is_refused_by_its_path(tmp_path, name):
    nominal, _ = nominal_of("arm", None, None, [])
    with pytest.raises(InvalidInput, match=f"{name} cannot be read"):
        criticise_files(nominal, "arm", [Path(name)], tmp_path, 0, silent)


def test_an_extended_model_finds_its_meshes_by_a_relative_path(tmp_path):
    """A folder that is moved or shared as a whole keeps working."""
    robot = tmp_path / "robot"
    (robot / "meshes").mkdir(parents=True)
    corners = [
        "v 0 0 0",
        "v 1 0 0",
        "v 0 1 0",
        "v 0 0 1",
        "f 1 3 2",
        "f 1 2 4",
        "f 1 4 3",
        "f 2 3 4",
    ]
    (robot / "meshes" / "part.obj").write_text("\n".join(corners))
    (robot / "robot.xml").write_text(
        """<mujoco><compiler meshdir="meshes"/><asset><mesh name="part" file="part.obj"/></asset>
        <worldbody><body name="link"><joint name="hinge"/><geom type="mesh" mesh="part"/></body>
        </worldbody></mujoco>"""
    )
    nominal, _ = nominal_of(None, None, robot / "robot.xml", [])
    extended = extend(nominal, nominal.start, []).xml
    assert str(tmp_path) in extended
    found = tmp_path / "found"
    found.mkdir()
    (found / "extended.xml").write_text(portable(extended, found))
    assert str(tmp_path) not in (found / "extended.xml").read_text()
    moved = tmp_path.with_name("moved")
    tmp_path.rename(moved)
    assert mujoco.MjModel.from_xml_path(str(moved / "found" / "extended.xml")).nmesh == 1
    moved.rename(tmp_path)


@pytest.mark.parametrize(
    ("other", "message"),
    [
        ("sub/../run.npz", "run.npz and .*run.npz are the same; give each recording once"),
        ("copy.npz", "run.npz and .*copy.npz have the same content; give each recording once"),
    ],
)
def test_a_recording_that_is_given_twice_is_refused(tmp_path, other, message):
    (tmp_path / "sub").mkdir()
    for name in ("run.npz", "copy.npz"):
        (tmp_path / name).write_bytes(b"twice")
    (tmp_path / "first.npz").write_bytes(b"another length")
    data = [tmp_path / name for name in ("first.npz", "run.npz", other)]
    with pytest.raises(InvalidInput, match=message):
        check_differ(data)
    nominal, name = nominal_of("arm", None, None, [])
    with pytest.raises(InvalidInput, match=message):
        criticise_files(nominal, name, data, tmp_path / "out", 0, silent)


def test_recordings_that_share_rows_are_refused_by_their_files(tmp_path):
    data = hide(*arm(), np.random.default_rng(0), [])
    first, second = tmp_path / "first.npz", tmp_path / "second.npz"
    first.write_bytes(data.episodes(range(10)).to_npz())
    second.write_bytes(data.episodes(range(9, 20)).to_npz())
    with pytest.raises(
        InvalidInput, match=r"first\.npz from row 684 on and second\.npz from row 0"
    ):
        criticise_files(arm()[1], "arm", [first, second], tmp_path / "out", 0, silent)


@pytest.mark.parametrize("file", ["bag_0.mcap", "data/chunk-000/episode_000000.parquet"])
def test_a_copied_folder_or_a_file_beside_its_folder_counts_once(tmp_path, file):
    for folder in ("first", "copy"):
        (tmp_path / folder / file).parent.mkdir(parents=True)
        (tmp_path / folder / file).write_bytes(b"rows")
    with pytest.raises(InvalidInput, match=r"first.* and .*copy.* have the same content"):
        check_differ([tmp_path / "first", tmp_path / "copy"])
    with pytest.raises(InvalidInput, match="are the same; give each recording once"):
        check_differ([tmp_path / "first", tmp_path / "first" / file])


def test_recordings_that_differ_and_files_that_are_not_there_are_not_called_the_same(tmp_path):
    (tmp_path / "run.npz").write_bytes(b"first")
    (tmp_path / "other.npz").write_bytes(b"other")
    check_differ([tmp_path / name for name in ("run.npz", "other.npz", "a.npz", "b.npz")])
    check_differ([tmp_path, tmp_path / "run.npz"])
