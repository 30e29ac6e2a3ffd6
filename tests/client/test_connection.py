"""The Python client, and servers that are not the service."""

import re
import threading
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer

import numpy as np
import pytest

from adr_service.client import connection
from adr_service.client.connection import AdrClient, check_benchmark
from adr_service.client.http import Refused, Unreachable
from adr_service.errors import InvalidInput
from adr_service.presets import PRESETS
from tests.api.smoke import SMOKE


@contextmanager
def serving(handler):
    """The address of a server that answers by a handler."""
    with HTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join(10)


class Answering(BaseHTTPRequestHandler):
    """Writes an answer, and no log."""

    def answer(self, code, headers, body):
        self.send_response(code)
        for name, value in headers.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_):
        pass


@contextmanager
def server(status, seconds=0.0, answers=()):
    """A server that answers every request with this status, after so many seconds.

    Its first requests get the answers, each a status, headers and a body.
    """
    done, first = threading.Event(), iter(answers)

    class Handler(Answering):
        def do_GET(self):
            done.wait(seconds)
            code, headers, body = next(first, (status, {}, b""))
            self.answer(code, headers, body)

    with serving(Handler) as url:
        yield url
        done.set()


@pytest.mark.parametrize("status", [502, 503, 504, 530])
def test_a_proxy_without_its_service_is_not_a_refusal(status):
    refused = pytest.raises(Unreachable, match=f"is not the service: {status}")
    with server(status) as url, AdrClient(url) as client, refused:
        client.ready()


RUNNING, ENDED = b'{"state": "running"}', b'{"state": "succeeded"}'
BUSY = (503, {"Retry-After": "0"}, b'{"detail": "the database is busy"}')


def test_a_proxy_that_says_not_to_wait_is_asked_again_after_half_a_second():
    refused = pytest.raises(Refused, match="the database is busy")
    with server(500, answers=[BUSY]) as url, AdrClient(url) as client, refused as error:
        client.ready()
    assert error.value.retry_after_s == 0.5


def test_who_watches_waits_while_the_service_is_busy_or_restarts(monkeypatch):
    monkeypatch.setattr(connection, "_POLL_S", 0.0)
    answers = [(200, {}, RUNNING), BUSY, (502, {}, b""), (200, {}, RUNNING), (200, {}, ENDED)]
    with server(500, answers=answers) as url, AdrClient(url) as client:
        states = [seen["state"] for seen in client.watch("run_0")]
    assert states == ["running", "running", "succeeded"]


@pytest.mark.parametrize(
    ("answers", "patience_s", "error"),
    [
        ([(502, {}, b"")], 300.0, Unreachable),  # there was none to begin with
        ([(200, {}, RUNNING), (404, {}, b'{"detail": "deleted"}')], 300.0, Refused),
        ([(200, {}, RUNNING), BUSY, BUSY], -1.0, Refused),
    ],
)
def test_who_watches_does_not_wait_for_ever(answers, patience_s, error, monkeypatch):
    monkeypatch.setattr(connection, "_POLL_S", 0.0)
    monkeypatch.setattr(connection, "_PATIENCE_S", patience_s)
    with server(500, answers=answers) as url, AdrClient(url) as client, pytest.raises(error):
        list(client.watch("run_0"))


@contextmanager
def keeping(monkeypatch, *answers):
    """A client of a server that answers submissions so, and the keys that came."""
    monkeypatch.setattr(connection, "_POLL_S", 0.0)
    keys, left = [], iter(answers)

    class Handler(Answering):
        def do_POST(self):
            self.rfile.read(int(self.headers["Content-Length"]))
            keys.append(self.headers["Idempotency-Key"])
            code, headers, body = next(left)
            if code is None:
                return  # the connection ends without an answer
            self.answer(code, headers, body)

    with serving(Handler) as url, AdrClient(url) as client:
        yield client, keys


def test_a_submission_whose_answer_was_lost_is_repeated_under_its_key(monkeypatch):
    answers = [(None, {}, b""), BUSY, (502, {}, b""), (202, {}, RUNNING), (202, {}, RUNNING)]
    with keeping(monkeypatch, *answers) as (client, keys):
        assert client.submit_run(SMOKE)["state"] == "running"
        client.submit_run(SMOKE)
    *first, second = keys
    assert len(first) == 4
    assert len(set(first)) == 1
    assert second not in {*first, None}


def test_an_answer_that_a_proxy_lost_is_asked_for_again(monkeypatch):
    with keeping(monkeypatch, (504, {}, b""), (202, {}, RUNNING)) as (client, keys):
        client.submit_run(SMOKE)
    assert len(keys) == 2


def test_a_service_that_is_away_for_an_hour_is_not_waited_for(monkeypatch):
    away = (503, {"Retry-After": "3600"}, b'{"detail": "maintenance"}')
    with keeping(monkeypatch, away) as (client, keys), pytest.raises(Refused, match="maintenance"):
        client.submit_run(SMOKE)
    assert len(keys) == 1


def test_a_dry_run_is_sent_once_and_without_a_key(monkeypatch):
    busy = pytest.raises(Refused, match="the database is busy")
    with keeping(monkeypatch, BUSY) as (client, keys), busy:
        client.submit_run(SMOKE, dry_run=True)
    assert keys == [None]


@pytest.mark.parametrize("key", ["", "prüfung", "two words", "line\n", "x" * 201])
def test_a_key_that_no_header_can_carry_is_refused(key):
    with AdrClient("http://127.0.0.1:9") as client, pytest.raises(InvalidInput, match="a key has"):
        client.submit_run(SMOKE, key=key)


def test_a_key_of_the_users_own_is_sent(monkeypatch):
    with keeping(monkeypatch, *[(202, {}, RUNNING)] * 3) as (client, keys):
        client.submit_run(SMOKE, key="one")
        client.submit_benchmark(SMOKE, key="two")
        client.submit_criticism(SMOKE, key="three")
    assert keys == ["one", "two", "three"]


@pytest.mark.parametrize("patience_s", [30.0, -1.0])
def test_a_submission_is_not_repeated_for_ever(patience_s, monkeypatch):
    monkeypatch.setattr(connection, "_SUBMITTING_S", patience_s)
    full = (429, {"Retry-After": "5"}, b'{"detail": "10001 runs would wait"}')
    answers = [full] if patience_s > 0 else [BUSY]
    with keeping(monkeypatch, *answers) as (client, keys):
        with pytest.raises(Refused):
            client.submit_run(SMOKE)
        assert len(keys) == len(answers)


def test_without_a_service_a_submission_ends_at_once():
    with serving(BaseHTTPRequestHandler) as url:
        pass
    with AdrClient(url) as client, pytest.raises(Unreachable, match="no service answers"):
        client.submit_run(SMOKE)


def test_another_server_gets_a_submission_once(monkeypatch):
    with keeping(monkeypatch, (200, {}, b"<html>")) as (client, keys):
        with pytest.raises(Unreachable, match="is not the service"):
            client.submit_run(SMOKE)
        assert len(keys) == 1


def test_another_server_is_not_taken_for_the_service():
    refused = pytest.raises(Unreachable, match="is not the service: GET /readyz gave no JSON")
    with server(200) as url, AdrClient(url) as client, refused:
        client.ready()


@pytest.mark.parametrize(
    ("status", "headers", "place"),
    [(301, {"Location": "https://adr.example/"}, "https://adr.example/"), (300, {}, "nowhere")],
)
def test_an_address_that_sends_elsewhere_is_not_taken_for_an_answer(status, headers, place):
    """A proxy sends http to https; its page was kept as a policy, a table or an archive."""
    moved = (status, headers, b"<html>moved</html>")
    refused = pytest.raises(
        Unreachable, match=f"answers {status} and sends to '{place}'; .* ADR_URL"
    )
    with server(200, answers=[moved]) as url, AdrClient(url) as client, refused:
        client.results_csv("run_0")


@pytest.mark.parametrize(
    "body",
    ['"nope"', "[1]", '{"detail": [{"loc": [], "msg": "no"}]}', '{"detail": "x", "errors": ["a"]}'],
)
def test_an_error_of_another_server_is_shown_as_it_is(body):
    refused = pytest.raises(Refused, match=re.escape(f"404 {body}"))
    with server(404, answers=[(404, {}, body.encode())]) as url, AdrClient(url) as client, refused:
        client.get("run_0")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"url": "http://127.0.0.1:abc"}, "'http://127.0.0.1:abc' is no address of a service"),
        ({"url": "localhost:8761"}, "begins with http:// or https://, .*given 'localhost:8761'"),
        ({"url": "127.0.0.1:8761"}, "begins with http:// or https://, .*given '127.0.0.1:8761'"),
        ({"url": "http://me:secret@here:abc"}, "^'http://here:abc' is no address of a service"),
        ({"url": "http://me:secret@here:abc/a@b"}, "^'http://here:abc/a@b' is no address"),
        ({"url": "me:secret@here:8761"}, "begins with http:// or https://, .*given 'here:8761'"),
        ({"url": "ftp://here"}, "begins with http:// or https://, .*given 'ftp://here'"),
        ({"url": "http://me:secret@here", "token": "x"}, "one password: .* for 'http://here'$"),
        ({"token": "geheim-ü"}, "ADR_TOKEN has characters that no token has"),
        ({"token": "from-a-file\n"}, "ADR_TOKEN has characters that no token has"),
    ],
)
def test_an_address_or_a_token_that_cannot_be_one_is_refused(given, message):
    with pytest.raises(InvalidInput, match=message):
        AdrClient(**given)


def test_a_password_in_an_address_is_sent_and_not_shown():
    sent = []

    class Handler(Answering):
        def do_GET(self):
            sent.append(self.headers["Authorization"])
            self.send_response(502)
            self.end_headers()

        def log_message(self, *_):
            pass

    with serving(Handler) as url, AdrClient(url.replace("//", "//me:secret@")) as client:
        assert client.url == url
        with pytest.raises(Unreachable) as refused:
            client.ready()
    assert sent == ["Basic bWU6c2VjcmV0"]
    assert "secret" not in str(refused.value)


def test_a_slow_answer_is_not_reported_as_an_absent_service():
    refused = pytest.raises(Unreachable, match="did not answer in time")
    with server(200, seconds=30) as url, AdrClient(url, timeout_s=0.2) as client, refused:
        client.ready()


@pytest.mark.ray
def test_a_refusal_and_an_absent_service_are_explained(service):
    with pytest.raises(Refused, match="did you mean 'arm'"):
        service.client.submit_run({**SMOKE, "task": "arn"})
    with (
        AdrClient("http://127.0.0.1:9") as nobody,
        pytest.raises(Unreachable, match="adr serve"),
    ):
        nobody.ready()


@pytest.mark.ray
def test_methods_and_presets_are_those_of_the_service(service):
    assert "DropoSettings" in service.client.methods()["$defs"]
    assert list(service.client.presets()) == list(PRESETS)


def test_what_is_of_a_benchmark_refuses_the_id_of_a_run():
    check_benchmark("bench_1", "claims are")
    with pytest.raises(InvalidInput, match="claims are of a benchmark; given run_1"):
        check_benchmark("run_1", "claims are")


@pytest.mark.parametrize("ask", ["get", "cancel", "results", "policy", "criticism"])
def test_an_empty_id_is_refused(ask):
    with AdrClient() as client, pytest.raises(InvalidInput, match=r"give the id of a .*given ''"):
        getattr(client, ask)("")


def test_a_name_in_the_place_of_a_list_of_tasks_is_refused():
    refused = pytest.raises(InvalidInput, match=r"tasks is a list, as \['arm'\]; given 'arm'")
    with AdrClient() as client, refused:
        client.claim_task("mine", "arm")


@contextmanager
def echo():
    """A client whose service answers every request with its body."""

    class Handler(Answering):
        def do_POST(self):
            body = self.rfile.read(int(self.headers["Content-Length"]))
            self.send_response(200)
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_):
            pass

    with serving(Handler) as url, AdrClient(url) as client:
        yield client


def test_values_of_numpy_and_ranges_are_sent_as_numbers_and_lists():
    spec = {
        "seed": np.int64(3),
        "seeds": range(2),
        "simopt": {"std": np.array([0.5, np.float32(1)])},
    }
    sent = {"seed": 3, "seeds": [0, 1], "simopt": {"std": [0.5, 1.0]}}
    with echo() as client:
        assert client.submit_run(spec) == client.submit_benchmark(spec) == sent
        assert client.submit_criticism(spec) == client.extend_benchmark("bench_1", spec) == sent


@pytest.mark.parametrize(
    ("value", "message"), [({3}, r"\{3\} is no number, text, list"), (np.nan, "not JSON compliant")]
)
def test_a_spec_with_what_json_does_not_have_is_refused(value, message):
    with AdrClient() as client, pytest.raises(InvalidInput, match=message):
        client.submit_run({"seed": value})


@pytest.mark.parametrize(("id", "shown"), [("run_1\r", r"'\\r'"), ("run_\udce9", r"'\\udce9'")])
def test_an_id_that_no_address_can_have_is_refused(id, shown):
    """A line end as from a file of another system, and a byte that is no UTF-8."""
    with AdrClient() as client, pytest.raises(InvalidInput, match=f"does not fit.*{shown}"):
        client.get(id)
