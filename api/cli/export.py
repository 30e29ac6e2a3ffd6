"""`adr export`: policies, learning curves and recordings as files of other tools."""

from pathlib import Path
from typing import Annotated

import typer

from adr_service.client import AdrClient, Json, connect
from adr_service.errors import InvalidInput
from adr_service.whole_files import written_whole
from api.cli.files import check_new
from api.cli.options import Id, Url
from api.cli.single_options import SingleOptionApp

app = SingleOptionApp(
    help="Write policies, learning curves and recordings for other tools.", no_args_is_help=True
)
Run = Annotated[str, typer.Argument(help="Id of a run.")]
Folder = Annotated[Path, typer.Argument(help="The folder to write.")]


@app.command()
def onnx(
    run: Run,
    file: Annotated[Path, typer.Argument(help="The file to write, .onnx.")],
    url: Url = None,
) -> None:
    """Write a run's policy as ONNX, with the names of its columns."""
    from adr_service.interchange.onnx_policies import to_onnx
    from adr_service.tasks.catalogue import get_task
    from adr_service.training.policy import Policy

    check_new(file)
    with connect(url) as client:
        spec, policy = _spec(client, run), Policy.from_bytes(client.policy(run))
    with written_whole(file) as part:
        part.write_bytes(to_onnx(policy, get_task(spec["task"]), {"run": run}))
    typer.echo(file)


@app.command("hugging-face")
def hugging_face(run: Run, folder: Folder, url: Url = None) -> None:
    """Write a run's policy as a folder for the Hugging Face Hub, with a model card."""
    from adr_service.interchange.hugging_face import write_model_folder
    from adr_service.tasks.catalogue import get_task
    from adr_service.training.policy import Policy

    with connect(url) as client:
        spec, policy = _spec(client, run), Policy.from_bytes(client.policy(run))
        rows = client.results(run)["rows"]
    write_model_folder(folder, policy, get_task(spec["task"]), spec, rows)
    typer.echo(folder)


@app.command("rl-zoo")
def rl_zoo(
    run: Run,
    logs: Annotated[Path, typer.Argument(help="The Zoo's folder of logs.")],
    url: Url = None,
) -> None:
    """Write a run's policy and its learning curve as a folder of RL Baselines3 Zoo."""
    from adr_service.interchange.rl_zoo import write_zoo_folder
    from adr_service.training.policy import Policy

    with connect(url) as client:
        spec, content = _spec(client, run), client.policy(run)
        curve = _curve_of(client, run, content)
    policy = Policy.from_bytes(content)
    typer.echo(write_zoo_folder(logs, policy, spec["task"], spec["variant"], curve))


@app.command()
def tensorboard(id: Id, folder: Folder, url: Url = None) -> None:
    """Write the learning curves of a run, or of all runs of a benchmark, for TensorBoard."""
    from adr_service.interchange.tensorboard import write_events

    if not id.startswith(("run_", "bench_")):
        raise InvalidInput(f"learning curves are of a run or a benchmark; given {id}")
    with connect(url) as client:
        runs = [run["id"] for run in client.get(id).get("runs", [{"id": id}])]
        curves = {run: found for run in runs if (found := client.curves(run))}
    if not curves:
        raise InvalidInput(f"no training of {id} has been evaluated yet")
    for run, found in curves.items():
        write_events(folder / run, found)
    typer.echo(f"tensorboard --logdir {folder}")


@app.command()
def minari(
    dataset: Annotated[str, typer.Argument(help="Id of an uploaded recording.")],
    name: Annotated[str, typer.Argument(help="Name for Minari, as adr/hopper-v0.")],
    task: Annotated[str, typer.Option(help="Task that was recorded: hopper, …")],
    url: Url = None,
) -> None:
    """Store an uploaded recording as a data set of Minari on this machine."""
    from adr_service.criticism.recordings import read_recording
    from adr_service.interchange.minari_datasets import to_minari
    from adr_service.tasks.catalogue import get_task

    recorded = get_task(task)
    with connect(url) as client:
        data = read_recording(recorded, client.recording(dataset))
    to_minari(data, recorded, name)
    typer.echo(f"minari show {name}")


def _spec(client: AdrClient, run: str) -> Json:
    """The spec of a run that has policies."""
    if not run.startswith("run_"):
        raise InvalidInput(f"{run} is no run, and has no single policy; adr list")
    spec: Json = client.get(run)["spec"]
    if spec["kind"] == "lost":
        raise InvalidInput(f"{run} cannot be read: {spec['reason']}")
    if spec["kind"] != "transfer":
        raise InvalidInput(f"{run} is a {spec['kind']}, and has no policy")
    return spec


def _curve_of(client: AdrClient, run: str, policy: bytes) -> list[Json]:
    """The learning curve of the training that made a run's policy."""
    finished = (each for each in reversed(client.trainings(run)) if each["is_finished"])
    for training in finished:
        if client.policy_of_training(run, training["digest"]) == policy:
            return training["curve"]
    raise InvalidInput(f"the training of {run}'s policy has no learning curve")
