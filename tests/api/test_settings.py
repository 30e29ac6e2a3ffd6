"""The service's settings."""

import os
import re
from contextlib import closing
from pathlib import Path

import pytest

from adr_service.errors import InvalidInput
from api.settings import read_settings, too_many_cores, unknown_variables
from db import runs
from db.session import open_database
from tests.db.rows import SPEC

SECRET = "s" * 16
ROOT = Path(__file__).parents[2]


def test_a_given_setting_replaces_the_environments(monkeypatch):
    monkeypatch.setenv("ADR_PORT", "8001")
    assert read_settings().port == 8001
    assert read_settings(port=8002).port == 8002


def test_rays_own_variable_names_the_cluster_unless_ours_does(monkeypatch):
    monkeypatch.setenv("RAY_ADDRESS", "head:6379")
    assert read_settings().ray_address == "head:6379"
    monkeypatch.setenv("ADR_RAY_ADDRESS", "auto")
    assert read_settings().ray_address == "auto"


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"port": 70_000}, r"ADR_PORT: .*65535 \(given: 70000\)"),
        ({"host": "0.0.0.0"}, "refusing to listen on '0.0.0.0' for everyone: set ADR_TOKEN"),  # noqa: S104
        ({"token": "short"}, "ADR_TOKEN must have 16 characters or more"),
        ({"token": SECRET, "robot_token": SECRET}, "ADR_ROBOT_TOKEN must not be ADR_TOKEN"),
        ({"robot_token": SECRET}, "has no effect without ADR_TOKEN"),
        ({"token": SECRET + "\n"}, "ADR_TOKEN has characters that no token has"),
        ({"rate": "many"}, "'many' is no rate; as 500/second"),
        ({"rate": "0/second"}, "'0/second' is no rate"),
        ({"rate": "5/second;0/hour"}, "'5/second;0/hour' is no rate"),
        ({"allowed_hosts": "adr, adr.org:80"}, "'adr.org:80' is no name; give it without a port"),
        ({"allowed_hosts": "https://adr.org"}, "'https://adr.org' is no name"),
        ({"allowed_hosts": "[2001:db8::1]"}, r"'\[2001:db8::1\]' is no name"),
        ({"ray_address": "head"}, "'head' is no address; accepted are local, auto, and HOST:PORT"),
        ({"ray_address": "head:"}, "'head:' is no address"),
        ({"ray_address": "http://head:8265"}, "'http://head:8265' is no address"),
        ({"ray_address": "auto", "cpus": 2}, "ADR_CPUS is for a Ray of the service's own"),
        ({"max_cores": 8}, "ADR_MAX_CORES and ADR_RESOURCE are for a cluster that is joined"),
        ({"ray_address": "auto", "max_cores": 0}, "ADR_MAX_CORES: .*greater than or equal to 1"),
        ({"runs_at_once": 0}, "ADR_RUNS_AT_ONCE: .*greater than or equal to 1"),
        ({"retention_days": 0}, "ADR_RETENTION_DAYS: .*greater than 0"),
        ({"data_dir": ""}, "ADR_DATA_DIR: an empty name is no folder; for the present one, give"),
        ({"keep_idle_s": "inf"}, "ADR_KEEP_IDLE_S: .*less than or equal to 31536000"),
        ({"keep_idle_s": 1e300}, "ADR_KEEP_IDLE_S: .*less than or equal to 31536000"),
        (
            {"ray_dashboard_url": "javascript:alert(1)"},
            r"'javascript:alert\(1\)' is no web address",
        ),
        ({"ray_dashboard_url": "ray:8265"}, "is no web address; as http://127.0.0.1:8265"),
        ({"proxies": "*"}, "'\\*' is no address; as 127.0.0.1 or 10.0.0.0/8"),
        ({"proxies": "127.0.0.1, nginx"}, "'nginx' is no address"),
        ({"proxies": "10.0.0.1/8"}, "'10.0.0.1/8' is no address"),
    ],
    ids=str,
)
def test_an_invalid_setting_is_named_with_the_accepted_values(given, message):
    with pytest.raises(InvalidInput, match=message):
        read_settings(**given)


def test_links_to_rays_dashboard_have_one_slash():
    assert (
        read_settings(ray_dashboard_url="https://ray.org/").ray_dashboard_url == "https://ray.org"
    )


def test_an_address_of_ipv6_is_a_name_of_the_service():
    names = "2001:db8::8a2e:370:7334, adr.example"
    assert read_settings(allowed_hosts=names).allowed_hosts == names


@pytest.mark.parametrize("variable", ["ADR_RAY_ADDRESS", "RAY_ADDRESS"])
def test_an_invalid_variable_is_named(monkeypatch, variable):
    monkeypatch.setenv(variable, "head")
    with pytest.raises(InvalidInput, match=r"ADR_RAY_ADDRESS: 'head' is no .* \(given: head\)"):
        read_settings()


def test_a_message_never_has_a_secret():
    for given in ({"token": "secret-but-short"[:10]}, {"token": 12345}, {"token": "s p" * 9}):
        with pytest.raises(InvalidInput) as refused:
            read_settings(**given)
        assert str(next(iter(given.values()))) not in str(refused.value)


def test_the_database_is_a_file_in_the_data_folder_unless_it_is_named(tmp_path):
    assert read_settings(data_dir=tmp_path).database == f"sqlite:///{tmp_path}/adr.sqlite"
    named = "postgresql+psycopg://adr@db.example.org/adr"
    assert read_settings(data_dir=tmp_path, database_url=named).database == named


@pytest.mark.parametrize("name", ["exp?1", "100%", "run%41", "a b", "ξ"])
def test_the_database_is_in_the_data_folder_whatever_its_name(name, tmp_path):
    folder = tmp_path / name
    folder.mkdir()
    with closing(open_database(read_settings(data_dir=folder).database)) as database:
        runs.create_run(database, SPEC)
    assert [path.parent for path in tmp_path.rglob("adr.sqlite")] == [folder]


def test_addresses_and_networks_of_proxies_are_accepted():
    given = "127.0.0.1, 10.0.0.0/8, 2001:db8::/32"
    assert read_settings(proxies=given).proxies == given


def test_the_service_writes_to_the_data_folder_and_to_that_of_an_sqlite_file(tmp_path):
    data, small = tmp_path / "data", tmp_path / "small"
    assert read_settings(data_dir=data).folders == {data}
    elsewhere = read_settings(data_dir=data, database_url=f"sqlite:///{small / 'adr.sqlite'}")
    assert elsewhere.folders == {data, small}
    server = read_settings(data_dir=data, database_url="postgresql+psycopg://adr@db/adr")
    assert server.folders == {data}
    with pytest.raises(InvalidInput, match="the database must be an SQLite file"):
        _ = read_settings(database_url="sqlite://").folders


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("ADR_TOKENS", "; did you mean ADR_TOKEN?"),
        ("adr_cpu", "; did you mean ADR_CPUS?"),
        ("ADR_XYZZY", ""),
    ],
)
def test_a_misspelt_variable_is_named_with_the_closest_known_one(name, hint):
    assert list(unknown_variables([name])) == [f"{name} is no setting, and has no effect{hint}"]


def test_every_variable_of_the_project_is_known():
    """Also those in lower case, which are settings as well, and others that are not ours."""
    files = [ROOT / "Makefile", ROOT / "docker-compose.yml", *(ROOT / "docs").rglob("*.md")]
    for folder in ("adr_service", "api", "benchmarks", "db", "workers", "docs/deploy"):
        files += [path for path in (ROOT / folder).rglob("*.*") if path.suffix != ".pyc"]
    text = "".join(path.read_text(errors="replace") for path in files if path.is_file())
    names = set(re.findall(r"\bADR_[A-Z_]*[A-Z]\b", text))
    assert {"ADR_TOKEN", "ADR_URL", "ADR_WORKER_CPUS"} <= names
    assert list(unknown_variables([*names, "adr_host", "RAY_ADDRESS", "HOME"])) == []


def test_more_cores_than_the_machine_has_are_named():
    here = len(os.sched_getaffinity(0))
    assert list(too_many_cores(read_settings(cpus=here))) == []
    (doubt,) = too_many_cores(read_settings(cpus=here + 1))
    assert doubt.startswith(f"ADR_CPUS is {here + 1}, but {here} cores are here")
