"""Schedules of faults for the dispatcher: a simulated Ray, a virtual clock, and what must hold.

    play_all(range(10_000))         # Figures, or Violation with the seed
    python -m tests.workers.schedules 1234

Real: the dispatcher's rounds, its inbox, the job table, the pool, the heartbeats with their board,
retries, and in a share of the schedules the database (SQLite in a file, with `db.stages`,
`db.visits`, `db.events` and `db.runs`). Replaced:

- Ray: functions of the module `ray`, so no process exists. The code of `workers.actors` does not
  run: a process signs, ends, dies or hangs as the schedule has it, and gives a stand-in result.
- Time: `time.monotonic` and `time.time` are virtual, and jump to where something happens next.
- Threads: runs, robots and the dispatcher take turns on one thread, between the dispatcher's
  rounds. The orchestrator and `RayStages` are replaced by the few lines that matter of them:
  a run asks for stages, waits for all, withdraws when it ends, and asks anew after a restart.
- In most schedules the database, by dictionaries with the same fences (`MemoryLedger`).
"""
