"""Recordings over HTTP: an offline method learns from one, with no target at all."""

import pytest

from adr_service.client import Refused
from adr_service.training.policy import Policy
from tests.api.smoke import SMOKE
from tests.recordings import recording
from tests.service import RunningService, wait_until_finished

pytestmark = pytest.mark.ray


@pytest.fixture(scope="module")
def content():
    return recording("arm", 100, [1.2, 0.6, 2.0, 1.0]).to_npz()


@pytest.fixture(scope="module")
def uploaded(service: RunningService, content):
    return service.client.upload(content, "arm")


def test_equal_uploads_are_one_dataset(service, http, content, uploaded):
    headers = {"Content-Type": "application/octet-stream"}
    again = http.post("/v1/datasets", content=content, headers=headers)
    assert (again.status_code, again.json()) == (200, uploaded)
    assert http.get(again.headers["Location"]).json() == uploaded
    assert http.get(uploaded["links"]["content"]).content == content
    assert uploaded["id"] in {data["id"] for data in service.client.list_all("datasets")}


def test_a_run_gives_a_distribution_and_a_policy(service, http, uploaded):
    target = {"kind": "recorded", "dataset": uploaded["id"]}
    method = {"name": "sysid", "iterations": 50}
    run = service.client.submit_run({**SMOKE, "method": method, "target": target})
    assert wait_until_finished(service.client, run["id"], 120)["state"] == "succeeded"
    found = service.client.distribution(run["id"])
    means = {p["name"]: p["mean"][0] for p in found["parameters"]}
    assert means == pytest.approx(
        {"upper_mass": 1.2, "fore_mass": 0.6, "shoulder_friction": 2.0, "elbow_friction": 1.0},
        rel=1e-6,  # there is no noise
    )
    assert Policy.from_bytes(service.client.policy(run["id"])).action_low.tolist() == [-1, -1]
    results = service.client.results(run["id"])
    assert results["rows"] == []
    assert {e["truth"] for e in results["estimates"]} == {None}
    assert service.client.figures(run["id"]) == ["parameters", "cost"]
    kinds = [
        e["event"]["kind"]
        for e in service.client.get_events(run["id"])
        if e["event"]["type"] == "stage_finished"
    ]
    assert kinds == ["infer", "train_policy"]
    with pytest.raises(Refused, match=f"{run['id']} learns from"):
        service.client.delete(uploaded["id"])


def test_a_dry_run_prices_the_recording(service, uploaded):
    spec = {**SMOKE, "method": "droid", "target": {"kind": "recorded", "dataset": uploaded["id"]}}
    plan = service.client.submit_run(spec, dry_run=True)["plan"]
    assert (plan["trainings"], plan["target_transitions"]) == (1, 0)
    assert plan["hours"] > 0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"dataset": "data_0"}, "there is no dataset 'data_0'"),
        ({"episodes": 9}, "has 1 episodes; asked for the first 9"),
        ({"kind": "robot"}, "one of simulated, recorded, external"),
    ],
)
def test_an_unknown_or_too_short_dataset_is_refused(service, uploaded, changes, message):
    target = {"kind": "recorded", "dataset": uploaded["id"], **changes}
    with pytest.raises(Refused, match=message):
        service.client.submit_run({**SMOKE, "method": "droid", "target": target})


def test_a_recording_of_another_robot_is_refused(service, content, uploaded):
    with pytest.raises(Refused, match="hopper measures 11 and takes 3"):
        service.client.upload(content, "hopper")
    target = {"kind": "recorded", "dataset": uploaded["id"]}
    with pytest.raises(Refused, match="hopper measures 11 and takes 3"):
        service.client.submit_run(
            {"task": "hopper", "method": "droid", "preset": "smoke", "target": target}
        )


def test_methods_that_visit_the_target_are_refused(service, uploaded):
    target = {"kind": "recorded", "dataset": uploaded["id"]}
    with pytest.raises(Refused, match="serves bayes_sim, droid, droid_smoothed, "):
        service.client.submit_run({**SMOKE, "target": target})


def test_an_upload_for_a_task_that_is_not_there_is_invalid(service, content):
    with pytest.raises(Refused, match=r"task.*hoper.*accepted.*hopper") as refused:
        service.client.upload(content, "hoper")
    assert refused.value.status == 422


def test_bytes_that_are_no_npz_are_refused(service, http):
    with pytest.raises(Refused, match="not a readable"):
        service.client.upload(b"nothing")
    large = http.post("/v1/datasets", content=b"x" * 64_000_001)
    assert large.status_code == 413
