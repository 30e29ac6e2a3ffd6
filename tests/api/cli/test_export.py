"""`adr export` on a real service: what each command writes is read by the library of its format."""

import minari
import numpy as np
import onnxruntime
import pytest
from huggingface_hub import ModelCard
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from adr_service.blind_test.planting import hide
from tests.api.conftest import finished  # noqa: F401 - a fixture
from tests.hidden import arm
from tests.recordings import recording

pytestmark = [pytest.mark.slow, pytest.mark.ray]


@pytest.fixture
def adr(adr_here, service, monkeypatch, tmp_path):
    monkeypatch.setenv("ADR_URL", service.client.url)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))

    def run(*arguments):
        status, out, errors = adr_here(*map(str, arguments))
        assert status == 0, errors
        return out

    return run


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_run_is_written_for_every_tool(adr, finished, tmp_path):  # noqa: F811
    adr("export", "onnx", finished, tmp_path / "policy.onnx")
    session = onnxruntime.InferenceSession((tmp_path / "policy.onnx").read_bytes())
    assert session.get_modelmeta().custom_metadata_map["run"] == finished
    adr("export", "hugging-face", finished, tmp_path / "model")
    assert "simopt" in ModelCard.load(tmp_path / "model/README.md").text
    adr("export", "tensorboard", finished, tmp_path / "curves")
    (first,) = tmp_path.glob("curves/*/training_0")
    assert EventAccumulator(str(first)).Reload().Scalars("eval/mean_reward")
    adr("export", "rl-zoo", finished, tmp_path / "logs")
    assert (tmp_path / "logs/sac/adr-RandomArm-v0_1/best_model.zip").exists()


def test_a_recording_goes_to_minari_and_comes_back(adr, tmp_path):
    file = tmp_path / "arm.npz"
    file.write_bytes(recording("arm", 20).to_npz())
    dataset = adr("upload", file, "--task", "arm").strip()
    assert "adr/arm-v0" in adr("export", "minari", dataset, "adr/arm-v0", "--task", "arm")
    assert minari.load_dataset("adr/arm-v0").total_steps == 20
    assert adr("upload", "minari:adr/arm-v0", "--task", "arm").strip() == dataset


def test_a_measurement_goes_to_minari_as_the_recording_that_methods_read(adr, tmp_path):
    file = tmp_path / "measured.npz"
    file.write_bytes(hide(*arm(), np.random.default_rng(0), []).episodes(range(2)).to_npz())
    dataset = adr("upload", file, "--task", "arm").strip()
    adr("export", "minari", dataset, "adr/measured-v0", "--task", "arm")
    assert minari.load_dataset("adr/measured-v0").total_episodes == 2


def test_what_has_no_policy_is_refused(adr_here, service):
    status, _, errors = adr_here("export", "onnx", "bench_1", "x.onnx", "--url", service.client.url)
    assert (status, "bench_1 is no run" in errors) == (2, True)
