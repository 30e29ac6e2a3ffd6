"""Options and files of `adr measure`."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.logs.conftest import MAP, XML, motion


@pytest.fixture
def files(tmp_path, monkeypatch):
    """A log, a model and a map, in the working directory."""
    monkeypatch.chdir(tmp_path)
    columns = motion(np.arange(0, 10, 0.004))
    np.savez("log.npz", **columns)
    (tmp_path / "robot.xml").write_text(XML)
    (tmp_path / "map.toml").write_text(MAP)
    return tmp_path


def test_without_a_map_a_draft_is_all_that_is_printed(adr_here, files):
    status, shown, errors = adr_here("measure", "log.npz", "--model", "robot.xml")
    assert (status, errors) == (0, "")
    assert shown.startswith("# columns: name, readings")
    assert '[joints.shoulder]\nposition = "q1"' in shown


def test_with_a_map_a_measurement_and_a_page_are_written(adr_here, files):
    out = ["--map", "map.toml", "--out", "found/measured.npz"]
    status, shown, _ = adr_here("measure", "log.npz", "--model", "robot.xml", *out)
    assert status == 0
    assert "found/measured.npz: 10 episodes, 2500 rows, 4 ms apart" in shown
    page, measurement = files / "found/measured.html", files / "found/measured.npz"
    assert "What the data could show" in page.read_text()
    assert measurement.stat().st_mtime_ns < page.stat().st_mtime_ns  # no page loses it
    measurement.unlink()
    status, _, errors = adr_here("measure", "log.npz", "--model", "robot.xml", *out)
    assert (status, "measured.html is there already" in errors) == (2, True)


def test_a_log_whose_name_is_no_utf_8_is_measured(files):
    """Its page could not be written, nor the name be printed, after all the work."""
    name, out = os.fsdecode(b"mess\xe4ung.npz"), os.fsdecode(b"\xe4.npz")
    Path("log.npz").rename(name)
    (files / "map.toml").write_bytes(b"\xef\xbb\xbf" + MAP.encode())  # as Windows saves it
    given = [name, "--model", "robot.xml", "--map", "map.toml", "--out", out]
    done = subprocess.run(
        [sys.executable, "-m", "api", "measure", *given],
        env={**os.environ, "PYTHONIOENCODING": "utf-8:strict"},
        capture_output=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, b"")
    assert done.stdout.startswith(b"\\udce4.npz: 10 episodes")
    assert "mess\\udce4ung.npz" in Path(out).with_suffix(".html").read_text()


def test_what_looks_wrong_is_in_the_terminal_and_on_the_page(adr_here, files):
    columns = motion(np.arange(0, 10, 0.004))
    np.savez("log.npz", **{**columns, "time": np.floor(columns["time"] / 0.01 + 1e-6) * 0.01})
    out = ["--map", "map.toml", "--out", "measured.npz"]
    _, shown, _ = adr_here("measure", "log.npz", "--model", "robot.xml", *out)
    for words in (" ".join(shown.split()), (files / "measured.html").read_text()):
        assert "1500 of 2500 readings" in words
        assert "have the time of the one before" in words


def test_more_rows_than_a_criticism_takes_are_refused_with_the_setting(adr_here, files):
    """One trial of 40 s and 300 short ones, which are padded to the longest."""
    trial = np.concatenate([np.zeros(10_000), 1 + np.arange(3000) // 10])
    np.savez("long.npz", trial=trial, **motion(0.004 * np.arange(13_000)))
    (files / "map.toml").write_text(f'[rows]\nepisode = "trial"\nseconds = 100.0\n{MAP}')
    out = ["--map", "map.toml", "--out", "measured.npz"]
    status, _, errors = adr_here("measure", "long.npz", "--model", "robot.xml", *out)
    assert status == 2
    assert "numbers at a time" in errors
    assert "rows.period of the map says how far rows are apart, here 0.004 s" in errors
    assert not (files / "measured.npz").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--map", "map.toml"], "give --map and --out, or neither"),
        (["--map", "map.toml", "--out", "measured.csv"], "--out is a file that ends on .npz"),
        (["--map", "none.toml", "--out", "a.npz"], "none.toml cannot be read"),
        (["--map", "log.npz", "--out", "a.npz"], "log.npz: it is no text in UTF-8"),
        (["--map", "robot.xml", "--out", "a.npz"], "the map is no TOML"),
    ],
)
def test_wrong_options_are_refused(adr_here, files, arguments, message):
    status, _, errors = adr_here("measure", "log.npz", "--model", "robot.xml", *arguments)
    assert status == 2
    assert message in errors
    assert not list(files.glob("a.*"))


def test_a_model_or_a_task_is_needed(adr_here, files):
    status, _, errors = adr_here("measure", "log.npz")
    assert (status, "give either --task or --model" in errors) == (2, True)


def test_a_log_that_is_given_twice_is_refused(adr_here, files):
    (files / "copy.npz").write_bytes((files / "log.npz").read_bytes())
    for twice in (["./log.npz"], ["copy.npz"]):
        status, _, errors = adr_here("measure", "log.npz", *twice, "--model", "robot.xml")
        assert status == 2
        assert f"log.npz and {twice[0].removeprefix('./')}" in errors
        assert "give each recording once" in errors
