"""Formats by ending."""

import pytest

from adr_service.errors import InvalidInput
from adr_service.logs.catalogue import read_logs


def test_another_ending_lists_those_accepted(tmp_path):
    (tmp_path / "log.xlsx").touch()
    with pytest.raises(InvalidInput, match=r"ends on '.xlsx'; accepted are .csv, .tsv"):
        read_logs(tmp_path / "log.xlsx")


@pytest.mark.parametrize("name", ["log.csv", "log.xlsx", "run", "run.db3"])
def test_a_missing_path_is_called_missing_whatever_its_ending(tmp_path, name):
    with pytest.raises(InvalidInput, match=f"{name} cannot be read: there is no such file"):
        read_logs(tmp_path / name)


@pytest.mark.parametrize(
    ("name", "command"),
    [
        ("run_0.db3", "ROS 2 bag in SQLite.*ros2 bag convert .*storage_id: mcap"),
        ("run_0.mcap.zstd", "a compressed ROS 2 bag.*ros2 bag convert .*storage_id: mcap"),
        ("run.bag", "a ROS 1 bag.*rosbags-convert .*--dst-storage mcap"),
    ],
)
def test_a_bag_of_another_form_is_refused_with_the_command_that_converts_it(
    tmp_path, name, command
):
    """Alone, and in the folder that a recorder writes."""
    (tmp_path / name).touch()
    (tmp_path / "metadata.yaml").touch()
    for path in (tmp_path / name, tmp_path):
        with pytest.raises(InvalidInput, match=f"{name} is .*{command}"):
            read_logs(path)


def test_a_file_that_is_too_large_is_refused_with_what_to_keep(tmp_path):
    with (tmp_path / "run.mcap").open("wb") as file:
        file.truncate(2**30 + 1)  # takes no space
    with pytest.raises(InvalidInput, match="keep only the joints' states and commands"):
        read_logs(tmp_path / "run.mcap")
