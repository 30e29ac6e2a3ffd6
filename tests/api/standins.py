"""A service in this process, on a database and without Ray."""

from collections import defaultdict
from threading import Lock

from fastapi import FastAPI
from fastapi.testclient import TestClient

from api import errors
from api.settings import Settings
from db.clock import SteadyClock


class Orchestrator:
    """Lists the runs that it was asked to start, and computes nothing."""

    cores = 2

    def __init__(self):
        self.started, self.activity = [], []
        self.clock = SteadyClock()

    def submit(self, record):
        self.started.append(record.id)

    def activities(self, run_id):
        return self.activity


class Service:
    """What routes call: a database, an orchestrator, and a queue that a test may fill."""

    dashboard_url = None

    def __init__(self, database):
        self.database, self.orchestrator = database, Orchestrator()
        self.refusal, self.settings = None, Settings()
        self.comparing, self.claims, self.claiming = defaultdict(Lock), {}, Lock()

    def check_queue(self, live):
        if self.refusal is not None:
            raise self.refusal

    def client(self, *routers):
        """A client of an application that has these routes alone."""
        app = FastAPI()
        errors.install(app)
        app.state.service, app.state.routers = self, routers
        for router in routers:
            app.include_router(router)
        return TestClient(app, follow_redirects=False)
