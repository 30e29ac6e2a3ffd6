"""A draft of the map from a log's columns to a model: what names and ranges of columns suggest."""

import json
from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from adr_service.criticism.compatibility import commanded_actuators, joints_of
from adr_service.logs.base import SECONDS, UNKNOWN, Log, nanoseconds_beside
from adr_service.logs.mapping import ANGLES, LENGTHS, is_servo, is_slide, joint_of

_TIMES = ("time", "timestamp", "stamp", "t")
_POSITIONS = ("position", "pos", "qpos", "q", "angle", "state")
_VELOCITIES = ("velocity", "vel", "qvel", "dq", "qd", "speed")
_COMMANDS = ("command", "cmd", "ctrl", "action", "u")
_EFFORTS = ("effort", "torque", "tau", "nm", "current", "i", "amps")
_SHORTEST = 2  # letters of an abbreviation: el for elbow
_LIKELY_S = 0.01  # between readings
_TURNS = 3 * 2 * np.pi  # a hinge that goes further is rather in degrees
_BY_NAME = "  # guessed by its name: check"
_BY_ORDER = "  # guessed by the order of the columns: check"
_MEASURED = "# its name is of an effort, which may be measured: give the commanded one"


def draft(logs: Sequence[Log], model: mujoco.MjModel) -> str:
    """A map to start from, with `?` where nothing says which column is a joint or a command.

    Comments list all columns with their ranges, and mark what is a guess.
    """
    names = list(dict.fromkeys(name for log in logs for name in log.names))
    lines = ["# columns: name, readings, smallest and largest", *_listing(logs[0])]
    if any(stream.stamps is None for stream in logs[0].streams):
        lines += ["", "[time]", *_clock(logs[0], names)]
    lines += ["", "[rows]", "seconds = 1.0  # length of an episode"]
    lines.append("# period = 0.01  # seconds between rows; about the readings' own, if left out")
    joints, drives = joints_of(model), commanded_actuators(model)
    positions = _matched(names, joints, _POSITIONS)
    positions |= _called(names, positions, drives)
    velocities = _matched(names, joints, _VELOCITIES)
    for joint in joints:
        lines += ["", f"[joints.{_key(joint)}]", _line("position", *positions[joint])]
        lines.append(_position_unit(logs[0], positions[joint][0], _units(model, joint)))
        lines.append("# scale = -1.0  # if it turns the other way than the model's")
        known = velocities[joint][0] != UNKNOWN
        lines.append(
            _line("velocity", *velocities[joint]) if known else "# no velocity: not measured"
        )
    commands = _commands(names, joints, model)
    for drive in drives:
        column, comment = commands[drive]
        lines += ["", f"[actuators.{_key(drive)}]", _line("command", column, comment)]
        if _kind(column) is _EFFORTS:
            lines.append(_MEASURED)
        joint, scale = joint_of(model, drive), 1.0
        if joint is not None and is_servo(model, drive):
            scale = model.actuator(drive).gear[0]  # its command is compared with gear × position
            named = column if _named_unit(column, _units(model, joint)) else positions[joint][0]
            lines.append(_position_unit(logs[0], named, _units(model, joint)))
        lines.append(
            f"scale = {float(scale)!r}  # of a reading in the model's command; negative if reversed"
        )
        lines.append('# between = "line"  # if the command changes faster than the log shows')
    return "\n".join(lines) + "\n"


def _commands(
    names: Sequence[str], joints: Sequence[str], model: mujoco.MjModel
) -> dict[str, tuple[str, str]]:
    """Column of each actuator's command, and a comment if it is a guess.

    An effort is the next best, and none for a servo, whose command is a position.
    """
    drives = commanded_actuators(model)
    commands = _matched(names, drives, _COMMANDS)
    commands |= _called(names, commands, joints)
    left = [drive for drive in drives if commands[drive][0] == UNKNOWN]
    pulled = [drive for drive in left if not is_servo(model, drive)]
    return commands | _matched(names, pulled, _EFFORTS)


def _listing(log: Log) -> list[str]:
    lines: list[str] = []
    for stream in log.streams:
        for name, values in stream.columns.items():
            known = values[np.isfinite(values)]
            reach = f"{known.min():.6g} to {known.max():.6g}" if known.size else "no numbers"
            lines.append(f"#   {_plain(name)}: {known.size}, {reach}")
    lines += [f"#   {_plain(name)}: cannot be read, {why}" for name, why in log.unread.items()]
    return lines


def _plain(name: str) -> str:
    """A name that stays within the line of a comment."""
    return name if name.isprintable() else _text(name)


def _called(
    names: Sequence[str], found: Mapping[str, tuple[str, str]], others: Sequence[str]
) -> dict[str, tuple[str, str]]:
    """Columns of elements that have none by its word, but one with their own name alone, which none
    of the `others` has."""
    plain = {name.lower(): name for name in names if _kind(name) is None}
    taken = {other.lower() for other in others}
    return {
        element: (plain[own], "")
        for element, (column, _) in found.items()
        if column == UNKNOWN and (own := element.lower()) in plain and own not in taken
    }


def _matched(
    names: Sequence[str], elements: Sequence[str], words: Sequence[str]
) -> dict[str, tuple[str, str]]:
    """Column of each element, and a comment if it is a guess.

    A column belongs to the element that its name contains. What is left is guessed: a column shares
    a word with one element alone, or abbreviates it. If nothing fits, and there are as many columns
    as elements, they are guessed by their order.
    """
    having = [name for name in names if _kind(name) is words]
    found: dict[str, tuple[str, str]] = {}
    for belongs, comment in ((_contains, ""), (_shares, _BY_NAME), (_abbreviates, _BY_NAME)):
        taken = {column for column, _ in found.values()}
        free = [column for column in having if column not in taken]
        for element in (each for each in elements if each not in found):
            own = [column for column in free if belongs(column, element)]
            others = [e for e in elements if e != element and e not in found]
            is_alone = len(own) == 1 and not any(belongs(own[0], other) for other in others)
            if is_alone:
                found[element] = own[0], comment
    if not found and len(having) == len(elements):
        comment = _BY_ORDER if len(elements) > 1 else ""
        return {each: (name, comment) for each, name in zip(elements, having, strict=True)}
    return {each: found.get(each, (UNKNOWN, "")) for each in elements}


def _contains(column: str, element: str) -> bool:
    return element.lower() in column.lower()


def _shares(column: str, element: str) -> bool:
    return bool(set(_words(column)) & set(_words(element)))


def _abbreviates(column: str, element: str) -> bool:
    short = [word for word in _words(column) if len(word) >= _SHORTEST]
    return any(word.startswith(each) for each in short for word in _words(element))


def _kind(name: str) -> Sequence[str] | None:
    """Group of words that a column's name belongs to; an angle's unit alone is a position."""
    groups = (_TIMES, _VELOCITIES, _COMMANDS, _EFFORTS, _POSITIONS, tuple(ANGLES))
    own = set(_words(name))
    group = next((group for group in groups if own & set(group)), None)
    return _POSITIONS if group == tuple(ANGLES) else group


def _clock(log: Log, names: Sequence[str]) -> list[str]:
    """Fields of the time: whole seconds with their nanoseconds, or else a column by its name."""
    time = next((name for name in names if _kind(name) is _TIMES), UNKNOWN)
    pairs = {name: rest for name in names if (rest := nanoseconds_beside(name, names)) is not None}
    found = [name for name, rest in pairs.items() if time in (name, rest)]
    if found or (pairs and time == UNKNOWN):
        name = next(iter(found or pairs))
        return [f"column = {_text(name)}", 'unit = "s"', f"nanoseconds = {_text(pairs[name])}"]
    return [f"column = {_text(time)}", _time_unit(log, time)]


def _time_unit(log: Log, column: str) -> str:
    """The unit that the name ends on, or else the one in which rows come at the likeliest pace."""
    named = _named_unit(column, tuple(SECONDS))
    unit = named or min(SECONDS, key=lambda unit: _oddness(log, column, SECONDS[unit]))
    return f'unit = "{unit}"  # {_choice(named, tuple(SECONDS))}'


def _oddness(log: Log, column: str, size: float) -> float:
    """Distance of the rows' pace from the likeliest one, in logarithms; `size` is the unit in s."""
    times = _values(log, column)
    pace = size * float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    return abs(np.log(pace / _LIKELY_S)) if pace > 0 else 0.0


def _units(model: mujoco.MjModel, joint: str) -> tuple[str, ...]:
    """Units of a joint's positions."""
    return tuple(LENGTHS if is_slide(model, joint) else ANGLES)


def _position_unit(log: Log, column: str, units: Sequence[str]) -> str:
    named, values = _named_unit(column, units), _values(log, column)
    is_wide = "deg" in units and len(values) > 0 and np.abs(values).max() > _TURNS
    unit = named or ("deg" if is_wide else units[0])
    return f'unit = "{unit}"  # {_choice(named, units)}'


def _choice(named: str | None, units: Sequence[str]) -> str:
    return ("" if named else "guessed: ") + ", ".join(units)


def _values(log: Log, column: str) -> np.ndarray:
    """The numbers of a column; none, if there is no such column."""
    for stream in log.streams:
        if column in stream.columns:
            values = stream.columns[column]
            return values[np.isfinite(values)]
    return np.empty(0)


def _named_unit(column: str, units: Sequence[str]) -> str | None:
    """The unit that a column's name ends on."""
    last = _words(column)[-1:]
    return next((unit for unit in units if [unit] == last), None)


def _words(name: str) -> list[str]:
    """Parts of a column's name, digits apart from letters: dq, 1 and deg of `dq1_deg`."""
    parts, word = [], ""
    for letter in name.lower():
        if word and (not letter.isalnum() or letter.isdigit() != word[-1].isdigit()):
            parts.append(word)
            word = ""
        word += letter if letter.isalnum() else ""
    return [*parts, word] if word else parts


def _line(field: str, column: str, comment: str) -> str:
    return f"{field} = {_text(column)}{comment}"


def _key(name: str) -> str:
    is_bare = name.replace("_", "").replace("-", "").isalnum() and name.isascii()
    return name if is_bare else _text(name)


def _text(name: str) -> str:
    """A name as a string of TOML, which has JSON's escapes but for those of two halves."""
    return json.dumps(name, ensure_ascii=False)
