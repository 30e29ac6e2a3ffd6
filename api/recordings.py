"""Recordings from files: what `adr upload` reads."""

from pathlib import Path

from adr_service.errors import InvalidInput
from adr_service.transitions import TransitionDataset


def read(file: Path, task_name: str) -> bytes:
    """The `.npz` of a recording; DROPO's four `.npy` files are put into one.

    Those say neither the control period nor the columns: the task's are taken.
    """
    if file.suffix:
        if file.suffix != ".npz":
            raise InvalidInput(f"a recording is an .npz, or a prefix of .npy files; given {file}")
        try:
            return file.read_bytes()
        except OSError as error:
            raise InvalidInput(f"{file} cannot be read: {error.strerror}") from error
    # importing the simulator takes a moment: only who needs it pays
    from adr_service.simulation.batch import control_period
    from adr_service.tasks.catalogue import get_task

    task = get_task(task_name)
    return TransitionDataset.from_npy(
        file,
        dt=control_period(task),
        columns=task.columns[: task.measured],
        origin=f"{file.name}_*.npy",
    ).to_npz()
