"""Connections are bounded, and a client that says nothing does not keep one for ever."""

import asyncio
import io
import json
import resource
import socket
import threading
import time
from contextlib import ExitStack, contextmanager, suppress

import httpx2
import pytest
import uvicorn
from fastapi import FastAPI, Request, Response

from adr_service.client import AdrClient, Refused
from api import connections, errors
from api.connections import bounded, connections_allowed
from tests.service import free_port, start_service, until, wait_until_finished

LARGE = 40_000_000  # bytes; more than the system's buffers take
RUN = {"task": "arm", "method": "prior", "preset": "smoke"}


@contextmanager
def served(most):
    """The port of a small application behind our connections."""
    app, port = FastAPI(), free_port()
    errors.install(app)
    app.state.routers = [app.router]

    @app.get("/quick")
    async def quick():
        return "here"

    @app.get("/slow")
    async def slow():
        await asyncio.sleep(2)
        return "here"

    @app.get("/large")
    async def large():
        return Response(bytes(LARGE))

    @app.post("/body")
    @app.post("/v1/archives")
    async def body(request: Request):
        return len(await request.body())

    config = uvicorn.Config(app, port=port, http=bounded(most), log_level="warning", lifespan="off")
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    try:
        until(lambda: server.started)
        yield port
    finally:
        server.should_exit = True
        thread.join(30)


def connected(port, sent=b""):
    client = socket.create_connection(("127.0.0.1", port), timeout=30)
    client.sendall(sent)
    return client


def get(path):
    return f"GET {path} HTTP/1.1\r\nHost: x\r\n\r\n".encode()


def test_the_longest_idle_connection_makes_room_for_a_new_one():
    with served(3) as port, ExitStack() as stack:
        silent = [stack.enter_context(connected(port)) for _ in range(3)]
        for _ in range(2):
            client = stack.enter_context(connected(port, get("/quick")))
            assert client.recv(1000).startswith(b"HTTP/1.1 200")
        assert silent[0].recv(1000).startswith(b"HTTP/1.1 503")
        assert silent[1].recv(1000).startswith(b"HTTP/1.1 503")


def test_where_all_are_at_work_a_new_one_is_refused_and_none_is_cut():
    with served(2) as port, ExitStack() as stack:
        busy = [stack.enter_context(connected(port, get("/slow"))) for _ in range(2)]
        time.sleep(0.5)  # for the requests to be read; nothing shows it
        refused = stack.enter_context(connected(port)).recv(1000)
        assert refused.startswith(b"HTTP/1.1 503")
        assert b"Retry-After" in refused
        for client in busy:
            assert client.recv(1000).startswith(b"HTTP/1.1 200")


@pytest.mark.parametrize("sent", [b"", b"GET /quick HT", get("/quick") + b"GET /"])
def test_headers_that_do_not_come_are_not_waited_for(monkeypatch, sent):
    monkeypatch.setitem(connections._SECONDS, "head", 0.5)
    with served(5) as port, connected(port, sent) as client:
        answered = b""
        while part := client.recv(1000):
            answered += part
        assert b"HTTP/1.1 408" in answered
        assert answered.count(b"HTTP/1.1 200") == sent.count(b"\r\n\r\n")


HEAD = b"POST %s HTTP/1.1\r\nHost: x\r\nContent-Length: 1000000\r\n\r\n"


def test_a_body_that_does_not_come_is_refused_and_not_waited_for(monkeypatch, caplog):
    monkeypatch.setitem(connections._SECONDS, "body", 0.5)
    with served(5) as port, connected(port, HEAD % b"/body" + b"some") as late:
        head, _, body = received(late).partition(b"\r\n\r\n")
        assert head.startswith(b"HTTP/1.1 408 ")
        assert b"application/problem+json" in head
        assert "60 MB" in json.loads(body)["detail"]
        with connected(port, HEAD % b"/body" + b"x" * 1_000_000) as client:
            assert b"1000000" in client.recv(1000)
    assert "Traceback" not in caplog.text


def test_a_client_that_goes_away_is_no_defect_of_the_service(caplog):
    with served(5) as port, connected(port, HEAD % b"/body" + b"some"):
        pass
    assert "Traceback" not in caplog.text


def test_a_client_whose_body_comes_too_slowly_learns_the_reason(monkeypatch):
    monkeypatch.setitem(connections._SECONDS, "body", 0.5)

    class Slow(io.BytesIO):
        def read(self, size=-1):
            time.sleep(0.05)  # a minute in all, if nobody refuses it
            return super().read(1)

    with served(5) as port, AdrClient(f"http://127.0.0.1:{port}") as client:
        with pytest.raises(Refused, match="the body came too slowly") as refused:
            client.import_archive(Slow(bytes(1200)))
        assert (refused.value.status, refused.value.retry_after_s) == (408, 2.0)  # a robot retries


@pytest.fixture
def clocks(monkeypatch):
    """The clocks of connections that have ended so far."""
    ended, late = [], connections._Bounded._late

    def _late(self):
        ended.append(self)
        late(self)

    monkeypatch.setattr(connections._Bounded, "_late", _late)
    return ended


def test_a_large_body_has_more_time_while_enough_of_it_comes(monkeypatch, clocks):
    monkeypatch.setitem(connections._SECONDS, "body", 1.0)
    monkeypatch.setattr(connections, "_ENOUGH_BYTES", 200_000)
    with served(5) as port, connected(port, HEAD % b"/body") as client:
        for part in range(4):
            client.sendall(b"x" * 250_000)
            if part < 3:
                until(lambda ended=part + 1: len(clocks) == ended)
        assert b"1000000" in client.recv(1000)


def test_a_body_that_goes_on_after_its_answer_has_no_more_time(monkeypatch, clocks):
    monkeypatch.setitem(connections._SECONDS, "body", 0.5)
    monkeypatch.setattr(connections, "_ENOUGH_BYTES", 1)
    with served(5) as port, connected(port, HEAD % b"/quick") as client:
        client.sendall(b"x" * 1000)
        assert received(client).startswith(b"HTTP/1.1 405 ")
        assert len(clocks) == 1


def received(client):
    """All bytes that come until the connection ends."""
    got = b""
    with suppress(ConnectionResetError):
        while part := client.recv(100_000):
            got += part
    return got


def test_who_reads_an_answer_slowly_gets_it_all_and_who_does_not_read_is_cut(monkeypatch):
    monkeypatch.setattr(connections, "_STALLED_S", 0.5)
    with served(5) as port, ExitStack() as stack:
        slow, silent = (stack.enter_context(connected(port, get("/large"))) for _ in range(2))
        got = 0
        while got < LARGE and (part := slow.recv(1_000_000)):
            got += len(part)
            time.sleep(0.05)  # 2 s and more in all, with progress all the time
        assert got >= LARGE
        assert read_to_the_end(silent) < LARGE


@pytest.fixture
def made(monkeypatch):
    """The connections that were made: a client that lost its own makes another in silence."""
    known, make = [], connections._Bounded.connection_made

    def connection_made(self, transport):
        known.append(transport)
        make(self, transport)

    monkeypatch.setattr(connections._Bounded, "connection_made", connection_made)
    return known


def test_a_client_that_reads_one_answer_after_the_other_keeps_its_connection(monkeypatch, made):
    monkeypatch.setattr(connections, "_STALLED_S", 0.3)
    with served(5) as port, httpx2.Client(base_url=f"http://127.0.0.1:{port}") as client:
        for _ in range(6):
            assert client.get("/quick").text == '"here"'
            with client.stream("GET", "/large") as answer:
                got = 0
                for part in answer.iter_raw(4_000_000):
                    got += len(part)
                    time.sleep(0.02)
            assert got == LARGE
    assert len(made) == 1


def read_to_the_end(client):
    """The number of bytes that come before the connection ends, in whatever way."""
    got = 0
    with suppress(ConnectionResetError):
        while part := client.recv(10_000_000):
            got += len(part)
    return got


def test_an_idle_client_that_asks_again_in_time_keeps_its_connection(monkeypatch, made):
    monkeypatch.setitem(connections._SECONDS, "head", 1.0)
    with served(5) as port, httpx2.Client(base_url=f"http://127.0.0.1:{port}") as client:
        for _ in range(4):
            assert client.get("/quick").text == '"here"'
            time.sleep(0.6)  # longer than the clock in all
    assert len(made) == 1


@pytest.mark.parametrize(("files", "allowed"), [(1024, 512), (600, 88), (100, 64), (10**6, 1000)])
def test_ray_and_the_database_keep_their_descriptors(monkeypatch, files, allowed):
    monkeypatch.setattr(resource, "getrlimit", lambda _: (files, files))
    assert connections_allowed() == allowed
    assert connections_allowed(7) == 7
    assert connections_allowed(10**9) == max(files, 576) - 512


@contextmanager
def files_allowed(number):
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (number, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


@pytest.mark.ray
@pytest.mark.slow
def test_a_thousand_idle_connections_cut_nobody_off(tmp_path):
    """At 1,024 descriptors they took all, and a run failed."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard != resource.RLIM_INFINITY and hard < 2500:
        pytest.skip(f"this machine allows {hard} open files, and the test needs 2,500")
    limited = ["prlimit", "--nofile=1024:1024"]
    with (
        files_allowed(max(soft, 2500)),
        start_service(tmp_path, cpus=1, wrapper=limited) as running,
        ExitStack() as stack,
    ):
        id = running.client.submit_run(RUN)["id"]
        port = int(running.client.url.rpartition(":")[2])
        for _ in range(1100):
            stack.enter_context(connected(port))
        with httpx2.Client(base_url=running.client.url, timeout=20) as other:
            assert other.get("/healthz").status_code == 200
        assert wait_until_finished(running.client, id, 120)["state"] == "succeeded"
