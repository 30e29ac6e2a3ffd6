"""The checks of a machine."""

import io
import json

import pytest
from rich.console import Console

from adr_service.plugins import METHODS
from api.cli import doctor
from api.cli.doctor import Check, report
from tests.packages import add_entry_point, python


@pytest.fixture
def without_simulator(monkeypatch):
    """Leave out the check that simulates every task: it takes a second."""
    monkeypatch.setattr(doctor, "_simulator", lambda: iter(()))


def shown(*checks):
    """True if a machine with these checks is fit, and the text on the terminal."""
    is_fit = report(Console(file=(output := io.StringIO()), width=200, markup=False), checks)
    return is_fit, output.getvalue()


def test_brackets_in_a_remedy_are_no_style():
    _, text = shown(Check(False, "pip install 'adr-service[fast]'", is_needed=False))
    assert "pip install 'adr-service[fast]'" in text


def test_only_needed_checks_decide():
    good, note, bad = Check(True, "a"), Check(False, "b", is_needed=False), Check(False, "c")
    assert shown(good, note) == (True, "ok   a\nnote b\n")
    assert shown(good, bad, good) == (False, "ok   a\nno   c\nok   a\n")


def test_this_machine_is_fit_though_no_service_answers(adr_here, tmp_path):
    status, text, _ = adr_here("doctor", "--url", "http://127.0.0.1:9")
    assert status == 0
    assert "MuJoCo simulates the tasks: arm, hopper" in text
    assert "connections at once, the rest for Ray and the database" in text
    assert "note no service answers at http://127.0.0.1:9" in text


def test_a_wrong_entry_point_of_a_method_is_named(tmp_path):
    """It was found by `adr serve`, which then did not start."""
    add_entry_point(tmp_path, METHODS, "nowhere:Settings", "missing")
    done = python(
        "from api.cli.doctor import _methods; check = _methods(); print(check.is_good, check.text)",
        tmp_path,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("False entry point 'missing' = 'nowhere:Settings' of the package")


@pytest.mark.usefixtures("without_simulator")
def test_settings_that_are_not_valid_are_named(adr_here, monkeypatch):
    monkeypatch.setenv("ADR_PORT", "many")
    status, text, _ = adr_here("doctor", "--url", "http://127.0.0.1:9")
    assert status == 1
    assert "the ADR_… settings are not valid: ADR_PORT" in text


@pytest.mark.usefixtures("without_simulator")
def test_an_address_that_is_none_does_not_end_the_report(adr_here):
    status, text, _ = adr_here("doctor", "--url", "http://127.0.0.1:abc")
    assert status == 1
    assert "no   'http://127.0.0.1:abc' is no address of a service" in text


@pytest.mark.ray
def test_a_service_is_looked_for_where_the_other_commands_do(adr, service):
    status, text = adr("doctor")
    assert status == 0
    assert f"a service answers at {service.client.url}" in text


@pytest.mark.usefixtures("without_simulator")
def test_as_json_a_program_can_read_every_check(adr_here):
    status, out, _ = adr_here("doctor", "--json", "--url", "http://127.0.0.1:9")
    found = json.loads(out)
    assert {"is_good", "text", "is_needed"} == set(found[0])
    assert status == (0 if all(each["is_good"] or not each["is_needed"] for each in found) else 1)


@pytest.mark.usefixtures("without_simulator")
def test_misspelt_variables_and_too_many_cores_are_notes(adr_here, monkeypatch):
    monkeypatch.setenv("ADR_TOKENS", "s" * 16)
    monkeypatch.setenv("ADR_CPUS", "9999")
    status, text, _ = adr_here("doctor", "--url", "http://127.0.0.1:9")
    assert status == 0
    assert "note ADR_TOKENS is no setting, and has no effect; did you mean ADR_TOKEN?" in text
    assert "note ADR_CPUS is 9999, but" in text


@pytest.mark.usefixtures("without_simulator")
def test_the_disks_of_the_data_and_of_the_database_are_checked(adr_here, monkeypatch, tmp_path):
    monkeypatch.setenv("ADR_DATA_DIR", str(tmp_path / "data"))
    monkeypatch.setenv("ADR_DATABASE_URL", f"sqlite:///{tmp_path}/small/adr.sqlite")
    _, text, _ = adr_here("doctor", "--url", "http://127.0.0.1:9")
    unfolded = text.replace("\n", "")
    assert f"GB free for {tmp_path}/data; 2 needed" in unfolded
    assert f"GB free for {tmp_path}/small; 2 needed" in unfolded
    monkeypatch.setenv("ADR_DATABASE_URL", "mysql://here")
    status, text, _ = adr_here("doctor", "--url", "http://127.0.0.1:9")
    assert status == 1
    assert "the ADR_… settings are not valid: the database must be an SQLite file" in text
