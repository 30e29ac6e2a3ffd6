"""A line on the progress of a run or a benchmark."""

from collections import Counter
from collections.abc import Iterable

from adr_service.client.tables import Json


def headline(seen: Json) -> str:
    """One line on the runs that are done, the stages in work, and those that wait."""
    runs = runs_of(seen)
    counts = Counter(run["state"] for run in runs)
    broken = [f", {counts[state]} {state}" for state in ("cancelled", "failed") if counts[state]]
    done = f"{succeeded(runs)}/{len(runs)} runs done"
    return "".join([done, *broken, *_in_work(stages_of(runs))])


def label(spec: Json) -> str:
    """A run in a few words: its method, and who collects for it where that is not as in the
    protocol; or its kind."""
    method = spec["method"] if "method" in spec else spec["kind"]
    name = method if isinstance(method, str) else method["name"]
    collector = spec.get("collector", "simopt")
    return name if collector == "simopt" else f"{name} on {collector}"


def runs_of(seen: Json) -> list[Json]:
    """The runs of a benchmark, or the run itself."""
    return seen.get("runs", [seen])


def succeeded(runs: Iterable[Json]) -> int:
    return sum(run["state"] == "succeeded" for run in runs)


def stages_of(runs: Iterable[Json]) -> list[tuple[Json, Json]]:
    """(run, stage) of every stage that runs or waits; a stage that runs share appears once."""
    first: dict[str, tuple[Json, Json]] = {}
    for run in runs:
        for stage in run["progress"]:
            first.setdefault(stage["digest"], (run, stage))
    return list(first.values())


def _in_work(stages: Iterable[tuple[Json, Json]]) -> list[str]:
    """Parts of the headline on stages that run or wait."""
    running: list[str] = []
    robots: list[str] = []
    cores = 0
    for run, stage in stages:
        spec, kind = run["spec"], stage["kind"]
        if stage["state"] == "running":
            running.append(f"{label(spec)}/{spec['seed']} {kind} {stage['fraction']:.0%}")
        elif stage["state"] == "waiting" and kind == "target_episode":
            robots.append(spec["task"])
        elif stage["state"] == "waiting":
            cores += 1
    parts = [f"; now {', '.join(running)}"] if running else []
    parts += [f"; {_waiting(cores)} for a core"] if cores else []
    tasks = ", ".join(sorted(set(robots)))
    left = "1 episode" if len(robots) == 1 else f"{len(robots)} episodes"
    return parts + ([f"; {left} left for a robot of {tasks}"] if robots else [])


def _waiting(stages: int) -> str:
    return "1 stage waits" if stages == 1 else f"{stages} stages wait"
