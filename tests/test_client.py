"""What clients are told of servers that are not the service."""

import threading
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer

import pytest

from api.client import AdrClient, Unreachable


@contextmanager
def server(status, seconds=0.0):
    """Answers everything like that, after so many seconds."""
    done = threading.Event()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            done.wait(seconds)
            self.send_response(status)
            self.end_headers()

        def log_message(self, *_):
            pass

    with HTTPServer(("127.0.0.1", 0), Handler) as serving:
        thread = threading.Thread(target=serving.serve_forever, daemon=True)
        thread.start()
        yield f"http://127.0.0.1:{serving.server_port}"
        done.set()
        serving.shutdown()
        thread.join(10)


@pytest.mark.parametrize("status", [502, 503, 504])
def test_a_proxy_without_its_service_is_not_a_refusal(status):
    refused = pytest.raises(Unreachable, match=f"is not the service: {status}")
    with server(status) as url, AdrClient(url) as client, refused:
        client.ready()


def test_a_slow_answer_is_not_told_as_no_service():
    refused = pytest.raises(Unreachable, match="did not answer in time")
    with server(200, seconds=30) as url, AdrClient(url, timeout_s=0.2) as client, refused:
        client.ready()
