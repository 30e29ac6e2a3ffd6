"""A service in this process, on a database and without Ray."""


class Orchestrator:
    """Lists the runs that it was asked to start, and computes nothing."""

    cores = 2

    def __init__(self):
        self.started, self.activity = [], []

    def submit(self, record):
        self.started.append(record.id)

    def activities(self, run_id):
        return self.activity


class Service:
    """What routes call: a database, an orchestrator, and a queue that a test may fill."""

    def __init__(self, database):
        self.database, self.orchestrator = database, Orchestrator()
        self.refusal = None

    def check_queue(self, live):
        if self.refusal is not None:
            raise self.refusal
