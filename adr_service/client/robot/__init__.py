"""The client of a robot: it runs the episodes that the service's runs wait for (docs/robots.md).

The robot is a Gymnasium environment: `reset` brings it to a start, `step` sends one command and
returns one control period later. The client never sends an action beyond its owner's limits. It
stops within one control step once it has lost its lease or its run is cancelled.
"""

from adr_service.client.robot.environment import RobotFailed
from adr_service.client.robot.limits import Limits
from adr_service.client.robot.worker import Robot

__all__ = ["Limits", "Robot", "RobotFailed"]
