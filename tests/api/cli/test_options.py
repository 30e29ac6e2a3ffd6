"""Options that several commands have."""

import pytest

from api.settings import read_settings


def test_commands_ask_at_the_port_on_which_the_server_listens(adr_here, monkeypatch):
    monkeypatch.delenv("ADR_URL", raising=False)
    monkeypatch.setenv("ADR_PORT", "9")
    assert read_settings().port == 9
    code, _, errors = adr_here("list")
    assert code == 5
    assert "127.0.0.1:9 " in errors
    monkeypatch.setenv("ADR_PORT", "nine")
    assert "ADR_PORT must be the number of a port; given 'nine'" in adr_here("list")[2]
    monkeypatch.setenv("ADR_URL", "http://127.0.0.1:10")
    assert "127.0.0.1:10 " in adr_here("list")[2]


@pytest.mark.parametrize("command", ["status", "watch", "cancel", "resume", "results", "cite"])
def test_a_recording_is_no_run(adr_here, command):
    code, _, errors = adr_here(command, "data_0123456789abcdef")
    assert code == 2
    assert "data_0123456789abcdef is of a recording" in errors.replace("\n", " ")


@pytest.mark.parametrize(
    ("command", "message"),
    [
        ("results run_0 --figure returns", "a figure ends in .svg, .png, .csv; given returns"),
        ("criticise --data a.npz --seed -1", "greater than or equal to 0"),
        ("render a.gif --task arm --seed -1", "greater than or equal to 0"),
        ("submit a.json --dry-run --watch", "--dry-run starts nothing that --watch could follow"),
        ("extend bench_0 --seed 3 --dry-run --watch", "--dry-run starts nothing"),
        ("criticise --out a --data a.npz --task arm --url http://a", "--url goes with --dataset"),
    ],
)
def test_options_that_cannot_be_obeyed_are_refused(adr_here, command, message):
    code, _, errors = adr_here(*command.split())
    assert code == 2
    assert message in errors.replace("\n", " ")


@pytest.mark.parametrize(
    "command",
    ["tune arm --over seed=[1] --seconds inf", "robot --task arm --env a:b --max-seconds inf"],
)
def test_a_number_without_an_end_is_refused(adr_here, command):
    status, _, errors = adr_here(*command.split())
    assert status == 2
    assert f"takes a finite number; given {command.split()[-1]}." in errors.replace("\n", " ")


@pytest.mark.parametrize("command", [["list"], ["status", "run_a"], ["results", "run_a"]], ids=str)
def test_the_address_of_the_service_may_come_from_the_environment(adr_here, monkeypatch, command):
    monkeypatch.setenv("ADR_URL", "http://127.0.0.1:9")
    code, _, errors = adr_here(*command)
    assert code == 5
    assert "127.0.0.1:9" in errors


@pytest.mark.parametrize(
    ("words", "option"),
    [
        (("submit", "--task", "hopper", "--method", "udr", "--method", "dropo"), "--method"),
        (("archive", "export", "bench_x", "a.adr", "--url", "http://a", "--url", "b"), "--url"),
    ],
)
def test_an_option_with_one_value_is_refused_when_given_twice(adr_here, words, option):
    status, out, errors = adr_here(*words)
    assert (status, out) == (2, "")
    assert f"Option {option} takes one value; it was given 2 times." in errors


def test_lists_and_switches_may_be_given_more_than_once(adr_here):
    words = ("extend", "bench_x", "--seed", "1", "--seed", "2", "--watch", "--no-watch")
    assert adr_here(*words, "--url", "http://127.0.0.1:9")[0] == 5
