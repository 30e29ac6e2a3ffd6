"""Criticisms over HTTP: a measurement goes up, a verdict and its files come down."""

import io
import json

import httpx2
import mujoco
import numpy as np
import pytest
from typer.testing import CliRunner

from adr_service.blind_test.planting import hide
from adr_service.client import Refused
from adr_service.criticism.report import FILES
from adr_service.effects.base import Effect
from adr_service.events import CriticismFinished
from adr_service.programs import run
from adr_service.specs import CriticismSpec
from adr_service.stages.local import LocalStages
from api.cli import app
from tests.hidden import arm, recorded
from tests.recordings import recording
from tests.service import RunningService, wait_until_finished

pytestmark = pytest.mark.ray
HIDDEN = Effect("joint_coulomb_friction", "joint:elbow", (0.15,))


@pytest.fixture(scope="module")
def content():
    """The .npz of an arm with friction that its simulator lacks."""
    task, nominal = arm()
    data = hide(task, nominal, np.random.default_rng(0), [HIDDEN]).episodes(range(8))
    np.savez(file := io.BytesIO(), **recorded(data))
    return file.getvalue()


@pytest.fixture(scope="module")
def uploaded(service: RunningService, content):
    return service.client.upload(content, "arm", "measured-arm.npz")


@pytest.fixture(scope="module")
def criticised(service: RunningService, uploaded):
    spec = {"task": "arm", "dataset": uploaded["id"]}
    submitted = service.client.submit_criticism(spec)
    assert submitted["verdict"] is None
    id = submitted["run"]["id"]
    assert wait_until_finished(service.client, id, 120)["state"] == "succeeded"
    return id


def test_a_measurement_is_a_dataset_with_counts_and_columns(uploaded):
    assert (uploaded["transitions"], uploaded["episodes"], uploaded["actions"]) == (600, 8, 2)
    assert uploaded["columns"] == ["qpos_0", "qpos_1", "qvel_0", "qvel_1"]


def test_the_hidden_cause_is_named_and_is_in_the_extended_model(service, criticised):
    found = service.client.criticism(criticised)
    (cause,) = found["verdict"]["causes"]
    assert (cause["kind"], cause["location"]) == (HIDDEN.kind, HIDDEN.location)
    assert cause["parameters"]["friction"]["value"] == pytest.approx(0.15, rel=0.03)
    xml = service.client.content(found["links"]["extended.xml"]).decode()
    assert mujoco.MjModel.from_xml_string(xml).dof_frictionloss[1] == pytest.approx(0.15, rel=0.03)
    effects = json.loads(service.client.criticism_file(criticised, "effects.json"))
    assert effects["effects"][0]["kind"] == HIDDEN.kind
    assert json.loads(service.client.criticism_file(criticised, "verdict.json")) == found["verdict"]


def test_the_report_is_a_page(service, criticised):
    link = service.client.criticism(criticised)["links"]["report.html"]
    with httpx2.Client(base_url=service.client.url) as http:
        response = http.get(link)
    assert response.headers["Content-Type"].startswith("text/html")
    assert "What arm, vanilla gets wrong" in response.text


@pytest.mark.slow
def test_the_verdict_is_the_same_without_a_service(service, content, uploaded, criticised):
    spec = CriticismSpec(task="arm", dataset=uploaded["id"])
    (finished,) = [e for e in run(spec, LocalStages(), content) if isinstance(e, CriticismFinished)]
    verdict = service.client.criticism(criticised)["verdict"]
    assert {**finished.verdict, "seconds": 0} == {**verdict, "seconds": 0}


def test_a_criticism_is_listed_among_runs(service, criticised):
    listed = service.client.list_all("runs", method="criticism")
    assert [entry["id"] for entry in listed] == [criticised]
    kinds = [kind["kind"] for kind in service.client.cost(criticised)["kinds"]]
    assert kinds == ["criticise"]
    assert service.client.results(criticised)["rows"] == []


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ({"task": "arm", "dataset": "data_0"}, "no dataset 'data_0'"),
        ({"task": "hopper"}, "qpos has 2 columns; the model needs 6 columns, for rootx"),
        ({"task": "leg"}, "no task 'leg'"),
    ],
)
def test_an_unknown_task_or_dataset_cannot_be_criticised(service, uploaded, spec, message):
    with pytest.raises(Refused, match=message):
        service.client.submit_criticism({"dataset": uploaded["id"], **spec})


def test_the_list_of_criticisms_and_that_of_datasets_name_the_file(http, criticised, uploaded):
    assert uploaded["origin"] == "measured-arm.npz"
    for address in ("/criticisms", "/datasets"):
        page = http.get(address).text
        assert "measured-arm.npz" in page
        assert f'href="/v1/datasets/{uploaded["id"]}/content"' in page


def test_data_that_do_not_fit_are_refused_with_the_reason(service, uploaded):
    learn = {"task": "hopper", "method": "dropo", "preset": "smoke"}
    target = {"kind": "recorded", "dataset": uploaded["id"]}
    with pytest.raises(Refused, match="qpos has 2 columns; the model needs 6 columns, for rootx"):
        service.client.submit_run({**learn, "target": target})
    other = service.client.upload(recording("arm", 40).to_npz())["id"]
    with pytest.raises(Refused, match="40 transitions in 1 episodes are too few"):
        service.client.submit_criticism({"task": "arm", "dataset": other})


def test_a_measurement_without_rows_is_refused(service, content):
    with np.load(io.BytesIO(content)) as fields:
        np.savez(file := io.BytesIO(), **{name: values[:0] for name, values in fields.items()})
    with pytest.raises(Refused, match="has no rows"):
        service.client.upload(file.getvalue())


def test_an_unknown_file_and_a_run_that_is_no_criticism_are_refused(service, criticised):
    with pytest.raises(Refused, match="accepted: "):
        service.client.criticism_file(criticised, "model.xml")
    other = service.client.submit_run({"task": "arm", "method": "prior", "preset": "smoke"})
    with pytest.raises(Refused, match="no criticism"):
        service.client.criticism(other["id"])


def test_the_command_line_writes_the_files_of_a_criticism_by_the_service(
    service, uploaded, criticised, tmp_path
):
    at = ["--url", service.client.url]
    asked = ["criticise", "--task", "arm", "--dataset", uploaded["id"], "--out", str(tmp_path)]
    done = CliRunner().invoke(app, [*asked, *at])
    assert done.exit_code == 0, done.output
    assert "joint_coulomb_friction" in done.output
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(FILES)
    done = CliRunner().invoke(app, [*asked[:-1], str(tmp_path / "again"), *at, "--json"])
    assert json.loads(done.stdout) == json.loads((tmp_path / "verdict.json").read_text())
    assert criticised in CliRunner().invoke(app, ["list", *at]).output
    assert "joint_coulomb_friction" in CliRunner().invoke(app, ["watch", criticised, *at]).output
