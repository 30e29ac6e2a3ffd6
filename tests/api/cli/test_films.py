"""`adr render`: films of recordings, and requests that it explains instead."""

import json
import os
import subprocess
import sys

import imageio.v3
import pytest

from tests.drawing import drawing
from tests.packages import ROOT
from tests.recordings import recording

__all__ = ["drawing"]


def adr(*arguments, **environment):
    return subprocess.run(
        [sys.executable, "-m", "api", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=120,
        cwd=ROOT,
        env={**os.environ, "COLUMNS": "300", **environment},
        check=False,
    )


@pytest.mark.usefixtures("drawing")
def test_the_command_films_a_recording(tmp_path):
    data = tmp_path / "data.npz"
    data.write_bytes(recording("hopper", 5).to_npz())
    done = adr("render", tmp_path / "film.gif", "--task", "hopper", "--data", data)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "2 pictures" in done.stdout
    assert imageio.v3.imread(tmp_path / "film.gif").shape[-2:] == (960, 3)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["film.avi", "--task", "hopper", "--data", "DATA"], ".gif or .mp4; given 'film.avi'"),
        (["film.gif", "--task", "hopper"], "give either --policy or --data"),
        (["film.gif", "--task", "hopper", "--data", "x.npz"], "x.npz cannot be read"),
        (
            ["film.gif", "--task", "hopper", "--policy", "README.md"],
            "README.md: not the bytes of a policy",
        ),
        (["film.gif", "--task", "hopper", "--data", "README.md"], "README.md: "),
        (["no/film.gif", "--task", "hopper", "--data", "DATA"], "there is no folder"),
        (["film.gif", "--task", "walker2d", "--data", "DATA"], "walker2d measures 17 and takes 6"),
        (["film.gif", "--task", "hopper", "--data", "DATA", "--episode", "1"], "episodes 0 to 0"),
        (
            ["film.gif", "--task", "hopper", "--data", "DATA", "--set", "leg=1"],
            "accepted: torso_mass",
        ),
        (
            ["film.gif", "--task", "hopper", "--data", "DATA", "--steps", "0"],
            "greater than or equal to 1",
        ),
    ],
)
def test_impossible_films_are_refused_with_the_reason(
    adr_here, tmp_path, monkeypatch, arguments, message
):
    monkeypatch.chdir(ROOT)
    data = tmp_path / "data.npz"
    data.write_bytes(recording("hopper", 3).to_npz())
    status, _, errors = adr_here("render", *(str(data) if a == "DATA" else a for a in arguments))
    assert status == 2
    assert message in " ".join(errors.split())


@pytest.mark.parametrize(
    "environment", [{"MUJOCO_EGL_DEVICE_ID": "99", "MUJOCO_GL": ""}, {"MUJOCO_GL": "glfw"}]
)
def test_a_machine_that_cannot_draw_names_the_packages_to_install(tmp_path, environment):
    data, film = tmp_path / "data.npz", tmp_path / "film.gif"
    data.write_bytes(recording("hopper", 2).to_npz())
    for display in ("DISPLAY", "WAYLAND_DISPLAY"):
        environment = environment | {display: ""}
    done = adr("render", film, "--task", "hopper", "--data", data, **environment)
    assert done.returncode == 2
    assert "apt install libegl1" in done.stderr
    assert not film.exists()


def test_a_distribution_of_another_variant_is_refused(adr_here, tmp_path):
    """Parameters that the file lacked were filmed at their true values."""
    mean = [{"name": "thigh_mass", "mean": [3.0]}]
    given = {"task": "hopper", "variant": "unmodeled", "parameters": mean, "distributions": []}
    (tmp_path / "d.json").write_text(json.dumps(given))
    files = ["--policy", "p.safetensors", "--distribution", str(tmp_path / "d.json")]
    film = str(tmp_path / "film.gif")
    status, _, errors = adr_here("render", film, "--task", "hopper", *files)
    assert status == 2
    assert "d.json is of hopper unmodeled, and the film of hopper vanilla: give" in errors
    status, _, errors = adr_here("render", film, "--task", "arm", *files)
    assert "give --task hopper --variant unmodeled" in errors
    given = ["--task", "hopper", "--variant", "unmodeled", *files]
    status, _, errors = adr_here("render", film, *given)
    assert "p.safetensors cannot be read" in errors
