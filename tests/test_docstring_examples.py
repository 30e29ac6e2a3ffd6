"""The small programs in the docstrings of modules run as written.

A program is an indented block of a module's docstring. It runs with the public names of its module
and with the names of `NAMES`, which stand for a reader's own values. `TABLES` lists the modules
that have a block with a table or a formula.
"""

import ast
import importlib
import re
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests import docstring_names as names

ROOT = Path(__file__).parent.parent
CLIENT = "adr_service.client"
PACKAGES = ("adr_service", "workers", "db", "api")
BLOCK = re.compile(r"(?:^|\n\n)((?:    .*\n?|\n(?=    ))+)")
TABLES = {"adr_service.simulation.model", "adr_service.criticism.noise", "db.visits"}
# these take a database's, a cluster's or an inner step's values: they are compiled and not run
COMPILED = {
    "api.filming",
    "api.report",
    "adr_service.interchange.minari_datasets",
    "adr_service.criticism.linear",
    "adr_service.criticism.linearisation",
    "adr_service.criticism.naming",
    "adr_service.criticism.next_recording",
    "adr_service.criticism.plans",
    "adr_service.criticism.revision",
    "adr_service.criticism.weighing",
    "adr_service.effects.signals",
    "adr_service.benchmark.cost",
    "adr_service.benchmark.improvements",
    "db.archive_checks",
    "db.visits",
    "workers.demand",
    "workers.dispatcher",
    "workers.heartbeats",
    "workers.job_table",
    "workers.orchestrator",
    "workers.tuning",
}
# each makes a whole criticism or several fits
SLOW = {
    "adr_service.blind_test",
    "adr_service.criticism.flexible_force",
    "adr_service.criticism.pipeline",
}
NAMES: dict[str, Callable[..., dict[str, Any]]] = {
    "adr_service.benchmark.aggregate": names.outcomes,
    "adr_service.benchmark.archive": names.archive_file,
    "adr_service.benchmark.checks": names.outcomes,
    "adr_service.benchmark.claims": names.outcomes,
    "adr_service.benchmark.figures": names.outcomes,
    "adr_service.benchmark.plan": names.benchmark_spec,
    "adr_service.benchmark.verification": names.stored_stage,
    "adr_service.blind_test": names.blind_test,
    "adr_service.blind_test.files": names.blind_test,
    "adr_service.blind_test.planting": names.blind_test,
    "adr_service.blind_test.scoring": names.blind_test,
    "adr_service.blind_test.sizing": names.blind_test,
    "adr_service.criticism.evidence": names.fitted,
    "adr_service.criticism.fits": names.fitted,
    "adr_service.criticism.flexible_force": names.fitted,
    "adr_service.criticism.identifiability": names.scanned,
    "adr_service.criticism.inverse": names.simulated,
    "adr_service.criticism.engine": names.robots,
    "adr_service.criticism.measurements": names.measurement_file,
    "adr_service.criticism.motions": names.random_motions,
    "adr_service.criticism.periods": names.scanned,
    "adr_service.criticism.probable_states": names.fitted,
    "adr_service.criticism.steps": names.fitted,
    "adr_service.criticism.pipeline": names.arm_with_an_effect,
    "adr_service.criticism.responses": names.fitted,
    "adr_service.criticism.scan": names.fitted,
    "adr_service.criticism.recordings": names.arm_file,
    "adr_service.criticism.smoothing": names.arm_recording,
    "adr_service.criticism.simulator": names.simulated,
    "adr_service.distributions": names.arm,
    "adr_service.interchange.hugging_face": names.exported_run,
    "adr_service.interchange.onnx_policies": names.exported_run,
    "adr_service.interchange.rl_zoo": names.exported_run,
    "adr_service.interchange.tensorboard": names.exported_run,
    "adr_service.logs": names.robot_log,
    "adr_service.logs.base": names.robot_log,
    "adr_service.effects.friction": names.robots,
    "adr_service.effects.models": names.hopper_model,
    "adr_service.parameters": names.parameter_values,
    "adr_service.programs": names.run_spec,
    "adr_service.randomness": names.stage,
    "adr_service.search.bayesian": names.points,
    "adr_service.search.cma_es": names.loss,
    "adr_service.search.neural_posterior": names.simulations,
    "adr_service.search.trust_region": names.likelihood,
    "adr_service.simulation.batch": names.arm,
    "adr_service.simulation.gym_env": names.environments,
    "adr_service.simulation.summaries": names.arm_recording,
    "adr_service.stages.base": names.policy,
    "db.archives": names.finished_database,
    "db.staging": names.exported_benchmark,
    "adr_service.target": names.target,
    "adr_service.tasks.check": names.tasks,
    "adr_service.training.curriculum": names.curriculum,
    "adr_service.training.policy": names.policy_file,
    "adr_service.training.train": names.training,
    "adr_service.transitions": names.recording_file,
    "api.connections": names.server,
    "api.uploads": names.upload,
    "db.schema": names.database_file,
    "workers.sessions": names.sessions,
}


def blocks(path: Path) -> Iterator[str]:
    """Yield the indented blocks of a module's docstring."""
    text = ast.get_docstring(ast.parse(path.read_text()))
    for block in BLOCK.findall(text or ""):
        yield textwrap.dedent(block).strip("\n")


def is_python(block: str) -> bool:
    try:
        ast.parse(block)
    except SyntaxError:
        return False
    return True


def module_of(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def modules() -> Iterator[tuple[str, str]]:
    """Yield (module, all its programs as one) of every module that has some."""
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            module = module_of(path)
            programs = [b for b in blocks(path) if module not in TABLES or is_python(b)]
            if programs:
                yield module, "\n".join(programs)


def execute(program: str, values: dict[str, Any]) -> None:
    """Run a program; one that yields stages is a program of a run, which `drive` carries out."""
    if "yield from" not in program:
        exec(compile(program, "docstring", "exec"), values)  # noqa: S102 - our own modules
        return
    body = textwrap.indent(program, "    ")
    exec(compile(f"def example():\n{body}\n", "docstring", "exec"), values)  # noqa: S102 - ours
    names.drive(values["example"]())


@pytest.mark.parametrize(
    ("module", "program"),
    [
        pytest.param(
            *(module, program),
            id=module,
            marks=[pytest.mark.ray] * (module == CLIENT) + [pytest.mark.slow] * (module in SLOW),
        )
        for module, program in modules()
    ],
)
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_program_in_a_docstring_runs(module, program, tmp_path, request, monkeypatch):
    monkeypatch.chdir(tmp_path)
    values = dict(vars(importlib.import_module(module)))
    if module in COMPILED:
        compile(program, module, "exec")
        return
    if module == CLIENT:
        values |= names.client(request.getfixturevalue("service"))
    elif module in NAMES:
        values |= NAMES[module](tmp_path)
    execute(program, values)


def test_programs_are_found_in_every_package():
    assert {module.partition(".")[0] for module, _ in modules()} == set(PACKAGES)


@pytest.mark.parametrize("module", sorted(TABLES))
def test_a_module_with_a_table_has_a_block_that_is_no_program(module):
    path = ROOT / (module.replace(".", "/") + ".py")
    assert not all(is_python(block) for block in blocks(path))
