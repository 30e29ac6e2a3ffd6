"""The command line as a whole."""

import subprocess
import sys

import pytest
from typer.main import get_command

from api.cli import app

COMMANDS = {
    *("serve", "submit", "extend", "list", "status", "watch", "cancel", "resume", "results"),
    *("claims", "upload", "datasets", "criticise", "tune", "render", "robot", "demo", "doctor"),
    *("report", "archive", "db", "measure", "criticise-bench"),
}
SLOW_TO_IMPORT = ("ray", "torch", "sqlalchemy", "fastapi", "uvicorn")


def test_the_commands_are_those_of_the_docs():
    assert set(get_command(app).commands) == COMMANDS


def test_help_imports_nothing_that_takes_seconds():
    code = f"import api.cli, sys; print([m for m in {SLOW_TO_IMPORT} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_every_command_and_option_has_a_help_text(name):
    command = get_command(app).commands[name]
    assert command.help
    for each in getattr(command, "commands", {name: command}).values():
        for parameter in each.params:
            assert parameter.help, f"{each.name} {parameter.name}"


def test_an_expected_error_is_one_message_and_status_2(adr_here):
    status, out, errors = adr_here("status", "run_x", "--url", "http://127.0.0.1:9")
    assert (status, out) == (2, "")
    assert errors.startswith("error: no service answers at http://127.0.0.1:9")
    assert "Traceback" not in errors
