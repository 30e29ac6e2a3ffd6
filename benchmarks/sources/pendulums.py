"""Pendulums of the DFKI Underactuated Lab: one link, and two links of two builds.

Wiebe et al., "Torque-limited simple pendulum: A toolkit for getting familiar with control
algorithms in underactuated robotics", JOSS 7(74), 2022, and "Open source dual-purpose acrobot and
pendubot platform", IEEE RAM, 2023; repositories dfki-ric-underactuated-lab/
torque_limited_simple_pendulum and .../double_pendulum. Quasi-direct drives (AK80-6) report
position, velocity and torque every 2 or 5 ms. docs/real-robots.md says what is known beyond the
logs.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from adr_service.criticism.measurements import Measurement
from adr_service.criticism.nominal import Nominal
from adr_service.logs.catalogue import read_logs
from adr_service.logs.conversion import convert
from adr_service.logs.mapping import LogMap
from adr_service.parameters import Parameter, ParameterSpace

_FREE = 0.2  # relative, of masses
_TORQUE = 12.0  # [N m] of the drives, by their data sheet


@dataclass(frozen=True)
class Link:
    """A link as the authors identified it."""

    length: float  # [m]
    mass: float  # [kg]
    centre: float  # [m] of its mass, from its joint
    inertia: float  # [kg m²] about its joint


A = (
    Link(0.3, 0.5593806151425046, 0.3, 0.053470810264216295),
    Link(0.2, 0.6043459469186889, 0.18377686083653508, 0.02392374528789766),
)
C = (
    Link(0.2, 0.5234602302310271, 0.2, 0.031887199591513114),
    Link(0.3, 0.6255677234174437, 0.25569305436052964, 0.05086984812807257),
)
_POINT, _ROD, _LENGTH = 0.546, 0.13, 0.5  # [kg], [kg], [m] of the simple pendulum
ONE = (
    Link(
        _LENGTH,
        _POINT + _ROD,
        (_POINT + _ROD / 2) * _LENGTH / (_POINT + _ROD),
        (_POINT + _ROD / 3) * _LENGTH**2,
    ),
)


def nominal(links: tuple[Link, ...]) -> Nominal:
    """Links that hang from a shoulder, without friction and without rotors; masses are free."""
    bodies = actuators = ends = ""
    place = "0 0 0"
    for number, link in enumerate(links, start=1):
        about = link.inertia - link.mass * link.centre**2
        bodies += f"""
        <body name="link{number}" pos="{place}">
          <joint name="joint{number}" axis="0 -1 0"/>
          <inertial pos="0 0 {-link.centre}" mass="{link.mass}"
                    diaginertia="{about} {about} {about}"/>"""
        actuators += f"""
        <motor name="joint{number}" joint="joint{number}" ctrlrange="{-_TORQUE} {_TORQUE}"/>"""
        ends, place = ends + "</body>", f"0 0 {-link.length}"
    xml = f"""
    <mujoco model="pendulum">
      <option timestep="0.001" integrator="implicitfast"/>
      <default><joint solreffriction="0.004 1"/></default>
      <worldbody>{bodies}{ends}</worldbody>
      <actuator>{actuators}</actuator>
    </mujoco>"""
    return Nominal.of_model(xml, ParameterSpace(tuple(map(_mass, range(1, 1 + len(links)), links))))


def _mass(number: int, link: Link) -> Parameter:
    low, high = ((1 + change) * link.mass for change in (-_FREE, _FREE))
    return Parameter(f"mass{number}", f"body:link{number}.inertial", "kg", low, high, 0.01)


@dataclass(frozen=True)
class Format:
    """Columns of a log, before each joint's number, and how it is cut into rows and episodes."""

    position: str
    velocity: str
    torque: str
    period: float = 0.01  # [s]
    seconds: float = 1.0  # of an episode


COMMANDED = Format("pos_meas", "vel_meas", "tau_con")
PLAIN = Format("pos", "vel", "tau")
PLAIN_SHORT = Format("pos", "vel", "tau", seconds=0.5)
SINGLE = Format("position", "velocity", "torque", period=0.005)


def read(files: Sequence[Path], links: tuple[Link, ...], columns: Format) -> Measurement:
    """A measurement of several logs. A log of one joint has no numbers in its columns' names."""
    text = f"[rows]\nperiod = {columns.period}\nseconds = {columns.seconds}\n"
    for joint in range(1, 1 + len(links)):
        number = joint if len(links) > 1 else ""
        text += f'[joints.joint{joint}]\nposition = "{columns.position}{number}"\n'
        text += f'velocity = "{columns.velocity}{number}"\n'
        text += f'[actuators.joint{joint}]\ncommand = "{columns.torque}{number}"\n'
    model = nominal(links)
    logs = [log for file in files for log in read_logs(file)]
    return convert(logs, LogMap.from_toml(text), model.model(model.start)).measurement
