"""A store of results in memory, in place of the database."""

from db.errors import DatabaseUnavailable


class Store:
    """Keeps what the dispatcher stores, and refuses it on demand."""

    def __init__(self):
        self.results, self.commits, self.notes = {}, [], []
        self.executions = {}  # by digest
        self.refusals = 0  # of the database, to come
        self.dropped = []

    def find(self, stage, run_id):
        self.refuse()
        return self.results.get(stage.digest)

    def note(self, stage, checkpoint, run_ids):
        self.notes.append((stage.digest, checkpoint, run_ids))

    def begin(self, beginnings):
        self.refuse()
        return ["lease"] * len(beginnings)

    def drop(self, stage):
        self.dropped.append(stage.digest)
        raise OSError("the file system is read-only")

    def commit(self, outcomes):
        self.refuse()
        if any("run_unlucky" in outcome.run_ids for outcome in outcomes):
            raise OSError("no space left on device")
        for outcome in outcomes:
            digest, execution = outcome.stage.digest, outcome.execution
            self.results[digest], self.executions[digest] = outcome.result, execution
            attempt, started_by = execution.attempt, execution.started_by
            self.commits.append((digest, attempt, started_by, sorted(outcome.run_ids)))
        return [outcome.result for outcome in outcomes]

    def refuse(self):
        if self.refusals > 0:
            self.refusals -= 1
            raise DatabaseUnavailable("the database cannot be used just now")
