"""The command line as a whole."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from typer.main import get_command

import adr_service
from adr_service.client import Refused, Unreachable
from adr_service.errors import InvalidInput
from api.cli import app, status_of
from api.cli.archive import NotVerified
from api.cli.own_service import ServiceDidNotStart
from api.cli.upkeep import Damaged
from db.errors import NotFound

COMMANDS = {
    *("serve", "submit", "extend", "list", "status", "watch", "cancel", "resume", "results"),
    *("claims", "upload", "datasets", "criticise", "tune", "render", "robot", "demo", "doctor"),
    *("cite", "report", "archive", "db", "measure", "criticise-bench", "export"),
}
ROOT = Path(__file__).parents[3]
SLOW_TO_IMPORT = ("ray", "torch", "sqlalchemy", "fastapi", "uvicorn")


def test_the_commands_are_those_of_the_docs():
    assert set(get_command(app).commands) == COMMANDS


def test_the_docs_name_commands_that_exist():
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    named = {c for page in pages for c in re.findall(r"`adr ([a-z-]+)", page.read_text())}
    assert len(named) > 10
    assert named <= COMMANDS


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


def test_an_expected_error_is_one_message_and_a_status_of_its_kind(adr_here):
    status, out, errors = adr_here("status", "run_x", "--url", "http://127.0.0.1:9")
    assert (status, out) == (5, "")
    assert errors.startswith("error: no service answers at http://127.0.0.1:9")
    assert "Traceback" not in errors


def test_a_file_that_the_system_refuses_is_told_without_its_number(adr_here, tmp_path):
    (file := tmp_path / "taken").write_text("")
    status, _, errors = adr_here("results", "bench_x", "--figures", str(file))
    assert status == 2
    assert errors.rstrip().endswith("taken: file exists")


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (InvalidInput("wrong"), 2),
        (OSError("no file"), 2),
        (NotVerified("other results"), 1),
        (Damaged("a page is missing"), 1),
        (ServiceDidNotStart("it hung"), 1),
        (Refused(422, "wrong"), 2),
        (NotFound("run", "run_0"), 3),
        (Refused(404, "there is none"), 3),
        (Refused(409, "it has ended"), 4),
        (Refused(429, "too many"), 4),
        (Refused(401, "the token"), 4),
        (Unreachable("nobody"), 5),
    ],
)
def test_errors_have_the_status_that_help_explains(error, status):
    assert status_of(error) == status


def test_the_version_is_told_with_those_that_change_numbers(adr_here):
    status, shown, _ = adr_here("--version")
    assert status == 0
    assert shown.splitlines()[0] == f"adr-service {adr_service.__version__}"
    assert {line.split()[0] for line in shown.splitlines()[1:]} >= {"mujoco", "torch"}
