"""Hostile uploads over HTTP: each gets a problem, and leaves no row, no file and no memory."""

import io
import sqlite3
import struct
import warnings
import zipfile
from contextlib import closing
from pathlib import Path

import httpx2
import numpy as np
import pytest

from adr_service.blind_test.planting import hide
from adr_service.criticism.measurements import Measurement
from adr_service.errors import InvalidInput, UnknownName
from adr_service.npz import write_arrays
from adr_service.specs import CriticismSpec, RunSpec
from adr_service.transitions import TransitionDataset, dataset_id
from api.routes import datasets, target_tasks
from api.uploads import Upload, check_dataset
from tests.api.standins import Service
from tests.hidden import arm, recorded
from tests.recordings import recording
from tests.service import until

ray = pytest.mark.ray
MEMORY_MB = 700  # that the service may grow by at its peak: an .npz of 256 MB, and copies of it
OCTETS = {"Content-Type": "application/octet-stream"}
GOOD = recording("arm", 50, [1.2, 0.6, 2.0, 1.0]).to_arrays()
GOOD_NPZ = write_arrays(GOOD)
PER_ROW = ("observations", "actions", "next_observations", "episodes", "terminals")
STEP = GOOD["observations"].shape


def changed(**arrays):
    """A good recording with some arrays replaced; None: left out."""
    kept = {**GOOD, **arrays}
    buffer = io.BytesIO()  # by NumPy, which writes objects too
    np.savez(buffer, **{name: value for name, value in kept.items() if value is not None})
    return buffer.getvalue()


def zipped(*members, compression=zipfile.ZIP_DEFLATED):
    buffer = io.BytesIO()
    with warnings.catch_warnings(), zipfile.ZipFile(buffer, "w", compression) as archive:
        warnings.simplefilter("ignore", UserWarning)  # of names that come twice
        for name, content in members:
            archive.writestr(name, content)
    return buffer.getvalue()


def npy(shape, dtype="<f8", data=b"", fortran=False):
    """An .npy whose header says what it likes."""
    header = f"{{'descr': '{dtype}', 'fortran_order': {fortran}, 'shape': {shape}, }}"
    return npy_of(header.encode(), data)


def npy_of(header, data=b"", version=1):
    length = struct.pack("<H" if version == 1 else "<I", len(header) + 1)
    return b"\x93NUMPY" + bytes([version, 0]) + length + header + b"\n" + data


def one(member, name="observations.npy"):
    """A good recording, but for one member."""
    with zipfile.ZipFile(io.BytesIO(GOOD_NPZ)) as archive:
        others = [(n, archive.read(n)) for n in archive.namelist() if n != name]
    return zipped(*others, (name, member))


class Pickled:
    def __reduce__(self):
        return (Path.touch, (Path("/tmp/adr-was-here"),))  # noqa: S108 - must not happen


def with_nan(name):
    values = np.array(GOOD[name], dtype=float)
    values.flat[3] = np.nan
    return changed(**{name: values})


def encrypted():
    content = bytearray(GOOD_NPZ)
    for mark, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        at = content.index(mark)
        content[at + offset] |= 1
    return bytes(content)


CORPUS = {
    "nothing": lambda: b"",
    "text": lambda: b"observations: 1 2 3",
    "a picture": lambda: b"\x89PNG\r\n\x1a\n" + b"\0" * 100,
    "a pickle": lambda: b"\x80\x04\x95\x0b\x00\x00\x00\x00\x00\x00\x00\x8c\x02os\x94.",
    "an npy": lambda: npy("(3,)", data=b"\0" * 24),
    "a zip of nothing": zipped,
    "a zip of text": lambda: zipped(("readme.txt", b"hello")),
    "cut in the middle": lambda: GOOD_NPZ[: len(GOOD_NPZ) // 2],
    "without its directory": lambda: GOOD_NPZ[:-40],
    "a form around it": lambda: b"--x\r\n\r\n" + GOOD_NPZ + b"\r\n--x--",
    "a directory that lies": lambda: GOOD_NPZ.replace(b"PK\x01\x02", b"PK\x01\x03"),
    "zeroed inside": lambda: GOOD_NPZ[:200] + b"\0" * 200 + GOOD_NPZ[400:],
    "encrypted": encrypted,
    "objects": lambda: changed(observations=np.array([[Pickled()] * 4] * 3, dtype=object)),
    "a path up": lambda: zipped(("../observations.npy", npy("(1,)", data=b"\0" * 8))),
    "an absolute path": lambda: zipped(("/etc/observations.npy", npy("(1,)", data=b"\0" * 8))),
    "a path of Windows": lambda: zipped(("..\\observations.npy", npy("(1,)", data=b"\0" * 8))),
    "a folder": lambda: zipped(("observations.npy/", b"")),
    "a member twice": lambda: zipped(*[("dt.npy", npy("()", data=b"\0" * 8))] * 2),
    "a thousand members": lambda: zipped(*((f"a{i}.npy", b"") for i in range(1000))),
    "an unknown array": lambda: changed(malware=np.zeros(3)),
    "a bomb": lambda: one(npy("(100000000,)", "|u1", b"\0" * 100_000_000)),
    "a bomb of bombs": lambda: zipped(("observations.npy", zipped(("x", b"\0" * 10_000_000)))),
    "a header of a promise": lambda: one(npy("(1000000000000, 4)")),
    "a header of an overflow": lambda: one(npy("(9223372036854775807, 9223372036854775807)")),
    "a negative shape": lambda: one(npy("(-5, 4)")),
    "a header of megabytes": lambda: one(npy_of(b"{" + b" " * 5_000_000, version=2)),
    "a header that is code": lambda: one(npy_of(b"__import__('os').abort()")),
    "a header that nests": lambda: one(npy_of(b"(" * 50_000)),
    "a header that is none": lambda: one(npy_of(b"\xff\xfe\x00")),
    "no header": lambda: one(b""),
    "another version": lambda: one(b"\x93NUMPY\x09\x00" + b"\0" * 100),
    "records": lambda: one(npy("(3,)", "V16", b"\0" * 48)),
    "complex numbers": lambda: changed(actions=GOOD["actions"].astype(complex)),
    "numbers of 16 bytes": lambda: changed(actions=GOOD["actions"].astype(np.longdouble)),
    "dates": lambda: changed(observations=np.zeros(STEP, "M8[s]")),
    "texts for numbers": lambda: changed(observations=np.full(STEP, "one")),
    "truths for numbers": lambda: changed(observations=np.zeros(STEP, bool)),
    "half characters": lambda: one(npy("(1,)", "<U1", struct.pack("<I", 0xD800)), "origin.npy"),
    "a million texts": lambda: changed(columns=np.full(1_000_000, "x")),
    "NaN in observations": lambda: with_nan("observations"),
    "NaN in actions": lambda: with_nan("actions"),
    "infinity": lambda: changed(next_observations=np.full(STEP, np.inf)),
    "one row less": lambda: changed(actions=GOOD["actions"][:-1]),
    "a column more": lambda: changed(observations=np.zeros((STEP[0], STEP[1] + 1))),
    "no columns": lambda: changed(**{name: np.empty((STEP[0], 0)) for name in PER_ROW[:3]}),
    "no dimension": lambda: changed(observations=np.array(1.0)),
    "three dimensions": lambda: changed(observations=GOOD["observations"][None]),
    "no rows": lambda: changed(
        **{k: v[:0] for k, v in GOOD.items() if k not in ("dt", "origin", "columns")}
    ),
    "no actions": lambda: changed(actions=None),
    "no ends": lambda: changed(episodes=None, terminals=None),
    "ends that are not": lambda: changed(terminals=np.full(STEP[0], 2)),
    "episodes back in time": lambda: changed(episodes=np.arange(STEP[0])[::-1], terminals=None),
    "a period of zero": lambda: changed(dt=np.array(0.0)),
    "a period before now": lambda: changed(dt=np.array(-0.02)),
    "many periods": lambda: changed(dt=np.full(STEP[0], 0.02)),
    "another robot's period": lambda: changed(dt=np.array(0.5)),
    "actions out of bounds": lambda: changed(actions=GOOD["actions"] + 10),
    "columns of another robot": lambda: changed(columns=np.array(["x [m]"] * STEP[1])),
}


def peak_mb(pid):
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    (line,) = [line for line in lines if line.startswith("VmHWM")]
    return int(line.split()[1]) / 1024


def rows(folder):
    """How many rows there are of everything that an upload could leave."""
    with closing(sqlite3.connect(folder / "adr.sqlite")) as database:
        tables = ("datasets", "artifacts", "stages", "stage_artifacts")
        return [database.execute(f"select count(*) from {t}").fetchone() for t in tables]  # noqa: S608


def files(folder):
    return sorted(p.name for p in folder.iterdir() if not p.name.startswith("adr.sqlite"))


@pytest.fixture(scope="module")
def http(service):
    with httpx2.Client(base_url=service.client.url, timeout=120) as client:
        yield client


@pytest.fixture(scope="module")
def claimed(service):
    """A robot's task, whose trajectory may be as hostile."""
    spec = {"task": "arm", "method": "dropo", "collector": "random", "preset": "smoke"}
    spec |= {"target": {"kind": "external"}, "training": {"max_steps": 300}}
    run = service.client.submit_run(spec)["id"]
    yield until(lambda: service.client.claim_task("hostile", ["arm"]))
    service.client.cancel(run)


@ray
def test_the_corpus_is_large_and_the_recording_it_changes_is_good(http):
    assert len(CORPUS) >= 40
    good = http.post("/v1/datasets?task=arm", content=GOOD_NPZ, headers=OCTETS)
    assert good.status_code in (200, 201)


@ray
@pytest.mark.parametrize("kind", CORPUS)
def test_a_hostile_upload_is_a_problem_and_leaves_nothing(service, http, claimed, kind):
    before, peak = (rows(service.data_dir), files(service.data_dir)), peak_mb(service.process.pid)
    content = CORPUS[kind]()
    id, lease = claimed["task"]["id"], claimed["lease"]
    for response in (
        http.post("/v1/datasets?task=arm", content=content, headers=OCTETS),
        http.put(
            f"/v1/target_tasks/{id}/trajectory",
            content=content,
            headers={**OCTETS, "Lease": lease},
        ),
    ):
        assert response.status_code in (400, 413, 415, 422)
        assert response.headers["Content-Type"] == "application/problem+json"
        assert len(response.json()["detail"]) < 2000
    assert (rows(service.data_dir), files(service.data_dir)) == before
    assert peak_mb(service.process.pid) - peak < MEMORY_MB
    assert not Path("/tmp/adr-was-here").exists()  # noqa: S108


@ray
def test_a_body_beyond_the_cap_is_not_even_read(service, http):
    peak = peak_mb(service.process.pid)
    response = http.post("/v1/datasets", content=b"P" * 70_000_000, headers=OCTETS)
    assert response.status_code == 413
    assert "64000000 bytes" in response.json()["detail"]
    assert peak_mb(service.process.pid) - peak < 150


@ray
def test_a_form_and_other_types_are_refused(http):
    for given in ("multipart/form-data; boundary=x", "application/json", "text/xml"):
        response = http.post("/v1/datasets", content=GOOD_NPZ, headers={"Content-Type": given})
        assert response.status_code in (400, 415), given


@pytest.mark.parametrize("content", [GOOD_NPZ, b"", b"{}"], ids=["npz", "nothing", "json"])
def test_json_is_refused_by_its_type_whatever_is_in_it(content):
    client = Service(None).client(datasets.router, target_tasks.router)
    headers = {"Content-Type": "application/json", "Lease": "x"}
    for answer in (
        client.post("/v1/datasets", content=content, headers=headers),
        client.put("/v1/target_tasks/task_0/trajectory", content=content, headers=headers),
    ):
        assert answer.status_code == 415
        expected = "the body must be application/octet-stream; given 'application/json'"
        assert answer.json()["detail"] == expected


@pytest.fixture
def measured():
    """The `.npz` of a measurement of an arm: states and commands."""
    task, nominal = arm()
    data = hide(task, nominal, np.random.default_rng(0), []).episodes(range(12))
    np.savez(file := io.BytesIO(), **recorded(data))
    return file.getvalue()


def test_an_upload_is_a_recording_or_a_measurement(measured):
    assert isinstance(Upload.parse(GOOD_NPZ).data, TransitionDataset)
    assert isinstance(Upload.parse(measured).data, Measurement)
    assert Upload.parse(measured).content is measured


def test_an_upload_is_of_one_robot_alone(measured):
    for content in (GOOD_NPZ, measured):
        upload = Upload.parse(content)
        upload.check_task("arm")
        with pytest.raises(InvalidInput):
            upload.check_task("hopper")
        with pytest.raises(UnknownName, match="did you mean 'arm'"):
            upload.check_task("amr")


def test_runs_and_criticisms_read_recordings_and_measurements_alike(measured):
    learn = {"task": "arm", "method": "droid", "preset": "smoke"}
    enough = TransitionDataset.concatenate([recording("arm", 40)] * 8).to_npz()
    for content in (measured, enough):
        data = dataset_id(content)
        target = {"kind": "recorded", "dataset": data}
        check_dataset(RunSpec.model_validate({**learn, "target": target}), content)
        check_dataset(CriticismSpec(task="arm", dataset=data), content)


def test_a_criticism_needs_more_than_a_method(measured):
    criticism = CriticismSpec(task="arm", dataset=dataset_id(GOOD_NPZ))
    with pytest.raises(InvalidInput, match="are too few to tell effects from noise"):
        check_dataset(criticism, GOOD_NPZ)
