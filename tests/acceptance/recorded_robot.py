"""A robot that writes its requests into a file: `python -m tests.acceptance.recorded_robot`."""

import sys
from pathlib import Path

from adr_service.client.robot import Limits, Robot
from tests.acceptance.lease_history import RecordedClient


def main(url: str, log: Path) -> None:
    """Run episodes of the arm as they come."""
    with log.open("a") as file:
        # robots of one name, which a trajectory has, so that each records the same bytes
        robot = Robot(
            lambda timeout_s: RecordedClient(url, timeout_s, file),
            "arm",
            "tests.robots:slowest_arm",
            "soak",
            Limits(),
            lambda line: sys.stderr.write(f"{line}\n"),
        )
        robot.work()


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
