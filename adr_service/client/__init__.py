"""The Python client of the service, and the client of a robot (`adr_service.client.robot`).

    with connect() as client:
        benchmark = client.submit_benchmark({"tasks": ["arm"], "methods": ["simopt"]})
        client.wait(benchmark["id"])
        client.results(benchmark["id"]).to_pandas()

Answers are the service's JSON, dictionaries and lists as its page `/docs` describes them. Tables
have `to_pandas()` besides. Every method raises `Refused` where the service refuses a request, and
`Unreachable` where none answers.
"""

from adr_service.client.connection import (
    DEFAULT_URL,
    AdrClient,
    check_benchmark,
    connect,
    is_finished,
)
from adr_service.client.http import Refused, Unreachable
from adr_service.client.tables import Json, Results, Rows

__all__ = [
    "DEFAULT_URL",
    "AdrClient",
    "Json",
    "Refused",
    "Results",
    "Rows",
    "Unreachable",
    "check_benchmark",
    "connect",
    "is_finished",
]
