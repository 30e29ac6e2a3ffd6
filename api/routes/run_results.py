"""/v1/runs/{id}/results and its figures, cost, distribution and policy."""

from typing import Any

from fastapi import APIRouter, Response
from fastapi.responses import FileResponse
from pydantic import BaseModel

from adr_service.benchmark.comparison import Outcome, decode
from adr_service.benchmark.figures import drawable
from adr_service.effects.base import Effect
from adr_service.parameters import ParameterSpace
from adr_service.specs.run import RunSpec
from adr_service.tasks.catalogue import source_of
from api.parameters import RENEWED, FigureName, FileFormat, RunId, TableFormat
from api.results import CostView, ResultsView, cost_of, outcomes_of, results_json
from api.routes.downloads import (
    CSV,
    artifact_response,
    bibtex_response,
    csv_response,
    figure_response,
)
from api.service import Service, ServiceDependency
from db import runs as run_store
from db import stages as stage_store
from db.errors import NotFound

router = APIRouter(prefix="/v1/runs", tags=["runs"])


class ParameterView(BaseModel):
    name: str
    address: str  # in the model
    unit: str
    mean: list[float]  # one per distribution
    std: list[float]


class DistributionView(BaseModel):
    """Training distribution of the latest policies; only UDR has several."""

    task: str
    variant: str  # whose source has these parameters
    extension: list[Effect]  # of that source
    method: str
    iteration: int
    parameters: list[ParameterView]
    distributions: list[dict[str, Any]]
    diagnostics: dict[str, Any]  # of the inference


def distribution_view(outcome: Outcome) -> DistributionView:
    """Return the distributions of an iteration, by parameter."""
    spec, distributions = outcome.spec, decode(outcome)
    return DistributionView(
        task=spec.task,
        variant=_variant_of(spec, distributions[0].space),
        extension=spec.extension,
        method=spec.column,
        iteration=outcome.iteration.iteration,
        parameters=[
            ParameterView(
                name=parameter.name,
                address=parameter.address,
                unit=parameter.unit,
                mean=[float(distribution.mean[i]) for distribution in distributions],
                std=[float(distribution.std[i]) for distribution in distributions],
            )
            for i, parameter in enumerate(distributions[0].space.parameters)
        ],
        distributions=list(outcome.iteration.distributions),
        diagnostics=outcome.iteration.diagnostics,
    )


def _variant_of(spec: RunSpec, space: ParameterSpace) -> str:
    """Variant whose source has this space: the run's own, or vanilla, where the oracle trains."""
    is_own = source_of(spec.task, spec.variant).space == space
    return spec.variant if is_own else "vanilla"


@router.get("/{run_id}/results", response_model=ResultsView, responses=CSV)
def results(run_id: RunId, service: ServiceDependency, format: TableFormat = "json") -> Response:
    """Result table after every iteration, comparisons, estimates and costs."""
    record = run_store.get_run(service.database, run_id)
    if format == "csv":
        return csv_response(run_id, outcomes_of(service, [record]))
    return Response(results_json(service, run_id, [record]), media_type="application/json")


@router.get("/{run_id}/cost")
def cost(run_id: RunId, service: ServiceDependency) -> CostView:
    """Cost of the stages, and utilisation of the cores."""
    return cost_of(service, [run_store.get_run(service.database, run_id)])


@router.get("/{run_id}/citations", response_class=Response)
def citations(run_id: RunId, service: ServiceDependency) -> Response:
    """The papers of what was run, as BibTeX."""
    return bibtex_response([run_store.get_run(service.database, run_id)])


@router.get("/{run_id}/figures")
def figures(run_id: RunId, service: ServiceDependency) -> list[str]:
    """Names of the figures that can be drawn by now."""
    return drawable(_outcomes(service, run_id))


@router.get(
    "/{run_id}/figures/{name}.{file_format}", response_class=Response, dependencies=[RENEWED]
)
def figure(
    run_id: RunId, name: FigureName, file_format: FileFormat, service: ServiceDependency
) -> Response:
    """A figure, or its numbers as CSV."""
    return figure_response(run_id, name, _outcomes(service, run_id), file_format)


@router.get("/{run_id}/distribution")
def distribution(run_id: RunId, service: ServiceDependency) -> DistributionView:
    """Training distribution of the latest policy: the method's estimate of each parameter."""
    return distribution_view(_latest(service, run_id, "finished iteration"))


@router.get("/{run_id}/policy", response_class=Response)
def policy(run_id: RunId, service: ServiceDependency) -> Response:
    """The latest evaluated policy, as safetensors; the first if there are several."""
    digest = _latest(service, run_id, "evaluated policy").iteration.policies[0]
    return artifact_response(service, digest, f"{run_id}.safetensors")


@router.get("/{run_id}/film.mp4", response_class=Response, dependencies=[RENEWED])
def film(run_id: RunId, service: ServiceDependency) -> Response:
    """An episode of the latest policy in the mean of its training distribution.

    Beside it is one on the target, where that is simulated. It takes seconds to a minute.
    """
    latest = _latest(service, run_id, "evaluated policy")
    digest = latest.iteration.policies[0]
    policy = stage_store.artifact(service.database, digest)
    if policy is None:
        raise NotFound("artifact", digest)
    about = distribution_view(latest).model_dump()
    # a file, because browsers ask for parts of films
    return FileResponse(service.films.of(latest.spec, policy, about), media_type="video/mp4")


def _latest(service: Service, run_id: str, kind: str) -> Outcome:
    """The outcome of a run's last iteration. Raises NotFound for a lack of this kind of thing."""
    outcomes = _outcomes(service, run_id)
    if not outcomes:
        raise NotFound(f"{kind} of run", run_id)
    return outcomes[-1]


def _outcomes(service: Service, run_id: str) -> list[Outcome]:
    return outcomes_of(service, [run_store.get_run(service.database, run_id)])
