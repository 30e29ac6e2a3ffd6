"""Signals that end a command, in a process of its own."""

import signal
import subprocess
import sys

import pytest

PROGRAM = """
import signal, sys, time
from api.cli.signals import end_as_by_ctrl_c

signal.signal(signal.SIGHUP, signal.SIG_IGN if "ignores" in sys.argv else signal.SIG_DFL)
end_as_by_ctrl_c()
try:
    print("ready", flush=True)
    sys.stdin.readline()
    print("goes on")
finally:
    print("cleaned up")
"""


def ended_by(number, *arguments):
    """Lines that a process prints after it got a signal and a line of input."""
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM, *arguments],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as process:
        assert process.stdout.readline() == "ready\n"
        process.send_signal(number)
        return process.communicate("\n")[0].splitlines()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_that_ends_a_command_lets_it_clean_up(number):
    assert ended_by(number) == ["cleaned up"]


def test_a_terminal_that_closes_does_not_end_what_nohup_protects():
    assert ended_by(signal.SIGHUP, "ignores") == ["goes on", "cleaned up"]
