"""The MJCF files are shipped with the package and are what the tasks read."""

import pytest

from adr_service.tasks.assets import read
from tests.tasks.cases import NAMES, TASKS


@pytest.mark.parametrize("task", TASKS, ids=NAMES)
def test_a_tasks_model_is_the_file_of_its_name(task):
    assert task.xml == read(f"{task.name}.xml")
    assert task.xml.lstrip().startswith(("<mujoco", "<!--"))


def test_a_file_that_is_not_there_is_named():
    with pytest.raises(FileNotFoundError, match=r"crab\.xml"):
        read("crab.xml")
