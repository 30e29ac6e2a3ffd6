"""All tasks of ours, and all their variants, for tests that run over every member."""

from adr_service.tasks.catalogue import BUILT_IN

TASKS = [entry.task for entry in BUILT_IN.values()]
NAMES = [task.name for task in TASKS]
CASES = [(entry.task, name) for entry in BUILT_IN.values() for name in entry.variants]
IDS = [f"{task.name}-{variant}" for task, variant in CASES]
