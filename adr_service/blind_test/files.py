"""The files of a blind test: questions, the key, and answers.

    write_question(Path("cases/0000"), case)
    question = read_question(Path("cases/0000"))    # the simulator, the measurement, the candidates
    answers = read_answers(Path("answers"), key)    # of `answers/0000/verdict.json` and so on

A question's folder has `model.xml`, `measured.npz` and `case.json`. The key is one file beside, for
the scorer alone. An answer is a `verdict.json` as `adr criticise` writes it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Literal, Self, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from adr_service.blind_test.cases import Hidden, check_task, draw_blind
from adr_service.blind_test.planting import Case
from adr_service.blind_test.sizing import plantable
from adr_service.criticism.extension import extend
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.nominal import Nominal
from adr_service.criticism.verdict import Conclusion
from adr_service.effects.base import Effect
from adr_service.effects.catalogue import MECHANISMS, get_mechanism
from adr_service.effects.models import unit_of
from adr_service.errors import InvalidInput, UnknownName
from adr_service.json_values import Wire, explain
from adr_service.parameters import Parameter, ParameterSpace
from adr_service.tasks.catalogue import get_task, source_of

QUESTION = ("model.xml", "measured.npz", "case.json")
_ANSWER = "verdict.json"
_T = TypeVar("_T", bound=BaseModel)


class Candidate(Wire):
    """An effect that a case may hide: a kind at a place, and what its strengths are called."""

    kind: str
    location: str
    strengths: Annotated[dict[str, str], Field(description="unit by name, in order")]


class CaseFile(Wire):
    """`case.json`: what a method may know beside the model and the measurement."""

    version: Annotated[int, Field(ge=1, le=1)] = 1
    free: Annotated[
        dict[str, Annotated[tuple[float, float], Field(strict=False)]],
        Field(description="bounds [SI] by address of parameters whose values in the model are off"),
    ]
    candidates: Annotated[
        tuple[Candidate, ...],
        Field(
            strict=False,
            description="a case hides none, one or two of these, or one effect that is not listed",
        ),
    ]


class Key(Wire):
    """`key.json`: what each case hides, by the name of its folder."""

    version: Annotated[int, Field(ge=1, le=1)] = 1
    seed: int
    cases: Annotated[dict[str, Hidden], Field(min_length=1)]


class Estimate(BaseModel):
    """A strength that an answer estimates; bounds that are null are unbounded."""

    model_config = ConfigDict(frozen=True, strict=True, allow_inf_nan=False)

    value: float
    low: float | None = None
    high: float | None = None

    @model_validator(mode="after")
    def _is_within(self) -> Self:
        if ("low" in self.model_fields_set) != ("high" in self.model_fields_set):
            raise ValueError("give both low and high (null where there is no bound), or neither")
        low, high = (bound if bound is not None else self.value for bound in (self.low, self.high))
        if not low <= self.value <= high:
            raise ValueError(
                f"the value {self.value:g} is not between low and high; given {low:g} to {high:g}"
            )
        return self

    @property
    def has_interval(self) -> bool:
        """True if it has an interval that is bounded on one side at least."""
        given = {"low", "high"} <= self.model_fields_set
        return given and (self.low is not None or self.high is not None)


class Named(BaseModel):
    """An effect that an answer names."""

    model_config = ConfigDict(frozen=True, strict=True)

    kind: str
    location: str
    parameters: dict[str, Estimate] = {}


class Left(BaseModel):
    """Everything that the named effects leave."""

    model_config = ConfigDict(frozen=True, strict=True)

    rest: Literal["none", "unknown"] = "none"


class Answer(BaseModel):
    """A method's answer to one question; further fields are ignored."""

    model_config = ConfigDict(frozen=True, strict=True, allow_inf_nan=False)

    verdict: Annotated[Conclusion, Field(strict=False)]
    causes: tuple[Named, ...] = ()
    tied: tuple[tuple[Named, ...], ...] = ()  # by cause, what explains as much
    residual: Left = Left()
    cpu_seconds: Annotated[float, Field(ge=0)] | None = None

    @classmethod
    def naming(cls, groups: Sequence[Sequence[Named]], rest: Literal["none", "unknown"]) -> Self:
        """An answer that names the first effect of each group, with which the others are tied."""
        is_tied = any(len(group) > 1 for group in groups)
        named = Conclusion.TIE if is_tied else Conclusion.CAUSE
        return cls(
            verdict=named if groups else Conclusion.NONE,
            causes=tuple(group[0] for group in groups),
            tied=tuple(tuple(group[1:]) for group in groups),
            residual=Left(rest=rest),
        )

    def groups(self) -> list[list[tuple[str, str]]]:
        """Each cause with what is tied with it, as kind and place."""
        tied = self.tied or ((),) * len(self.causes)
        return [
            [(each.kind, each.location) for each in (cause, *others)]
            for cause, others in zip(self.causes, tied, strict=True)
        ]


@dataclass(frozen=True)
class Question:
    """The part of a case that a method may see."""

    nominal: Nominal  # the simulator, whose free parameters are off
    measurement: Measurement
    candidates: tuple[Effect, ...]  # of unit strength


def make_cases(folder: Path, key: Path, tasks: Sequence[str], count: int, seed: int) -> None:
    """Write the questions of `count` cases, of the tasks in turn, and their key.

    Raises UnknownName for a task that has no blind test.
    """
    for task in tasks:
        check_task(task)
    hidden: dict[str, Hidden] = {}
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        name = f"{number:04d}"
        hidden[name], case = draw_blind(tasks[number % len(tasks)], rng)
        write_question(folder / name, case)
    key.parent.mkdir(parents=True, exist_ok=True)
    key.write_text(Key(seed=seed, cases=hidden).model_dump_json(indent=1) + "\n")


def write_question(folder: Path, case: Case) -> None:
    """Write a case as files, without what it hides."""
    nominal = case.nominal
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "model.xml").write_text(extend(nominal, nominal.start, ()).xml)
    (folder / "measured.npz").write_bytes(case.measurement.to_npz())
    model = nominal.model(nominal.start)
    known = CaseFile(
        free={p.address: (p.low, p.high) for p in nominal.space.parameters},
        candidates=tuple(
            Candidate(
                kind=kind,
                location=location,
                strengths={
                    s.name: unit_of(model, location, s.unit) for s in get_mechanism(kind).strengths
                },
            )
            for kind, location in plantable(model)
        ),
    )
    (folder / "case.json").write_text(known.model_dump_json(indent=1) + "\n")


def questions_in(folder: Path) -> list[Path]:
    """The folders of all questions; raises InvalidInput if there are none."""
    questions = sorted(path.parent for path in folder.glob("*/case.json"))
    if not questions:
        raise InvalidInput(f"{folder} has no cases; expected are files as 0000/case.json")
    return questions


def read_question(folder: Path) -> Question:
    """Raises InvalidInput with what is wrong in which file."""
    known = _read(CaseFile, folder / "case.json")
    space = ParameterSpace(
        tuple(Parameter(a, a, "SI", low, high, low) for a, (low, high) in known.free.items())
    )
    candidates = [Effect(c.kind, c.location, (1.0,) * len(c.strengths)) for c in known.candidates]
    model, data = _text(folder / "model.xml"), _content(folder / "measured.npz")
    try:
        nominal, measurement = Nominal.of_model(model, space), Measurement.from_npz(data)
    except InvalidInput as error:
        raise InvalidInput(f"{folder}: {error}") from error
    return Question(nominal, measurement, tuple(candidates))


def read_key(path: Path) -> Key:
    """Raises InvalidInput with what is wrong."""
    return _read(Key, path)


def write_answer(folder: Path, answer: Answer) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / _ANSWER).write_text(answer.model_dump_json(indent=1, exclude_unset=True) + "\n")


def has_answer(folder: Path) -> bool:
    return (folder / _ANSWER).is_file()


def read_answers(folder: Path, key: Key) -> dict[str, Answer]:
    """The answers in a folder, by case; raises InvalidInput for one to no case of the key."""
    if not folder.is_dir():
        raise InvalidInput(f"{folder} is no folder of answers, as {folder}/0000/{_ANSWER}")
    names = sorted(path.parent.name for path in folder.glob(f"*/{_ANSWER}"))
    if not names:
        raise InvalidInput(f"{folder} has no answers; expected are files as 0000/{_ANSWER}")
    if others := [name for name in names if name not in key.cases]:
        raise InvalidInput(
            f"{folder} answers {', '.join(others)}, which the key does not have; its "
            f"{len(key.cases)} cases are {min(key.cases)} to {max(key.cases)}"
        )
    return {name: _read_answer(folder / name / _ANSWER, key.cases[name].task) for name in names}


def _read_answer(path: Path, task: str) -> Answer:
    answer = _read(Answer, path)
    known = _effects_of(task)
    for named in (*answer.causes, *(each for group in answer.tied for each in group)):
        if (effect := f"{named.kind} {named.location}") not in known:
            raise UnknownName(f"effect that {path} names", effect, known)
        strengths = [each.name for each in MECHANISMS[named.kind].strengths]
        is_group = named.location.endswith(":*")  # whose strengths have their places' names as well
        for name in () if is_group else named.parameters:
            if name not in strengths:
                raise UnknownName(f"strength of {effect}, which {path} names,", name, strengths)
    if answer.tied and len(answer.tied) != len(answer.causes):
        raise InvalidInput(
            f"{path}: tied has {len(answer.tied)} lists for {len(answer.causes)} causes; expected "
            "is one for each, or none at all"
        )
    is_named = answer.verdict in (Conclusion.CAUSE, Conclusion.TIE)
    if is_named and not answer.causes:
        raise InvalidInput(f"{path}: the verdict is {answer.verdict.value}, but causes is empty")
    if is_named and any(answer.tied) != (answer.verdict == Conclusion.TIE):
        raise InvalidInput(
            f"{path}: the verdict is {answer.verdict.value}, but "
            f"{'tied names others' if any(answer.tied) else 'nothing is tied'}"
        )
    is_silent = not answer.causes and answer.residual.rest == "none"
    if answer.verdict == Conclusion.NONE and not is_silent:
        raise InvalidInput(f"{path}: the verdict is none, but something is named or left")
    return answer


@cache
def _effects_of(task: str) -> frozenset[str]:
    """Kind and place of every effect that a task's robot may have, and of groups of them."""
    nominal = Nominal.of_task(get_task(task), source_of(task, "vanilla"))
    model = nominal.model(nominal.start)
    places = {kind: each.locations(model) for kind, each in MECHANISMS.items()}
    groups = {kind: {f"{p.partition(':')[0]}:*" for p in each} for kind, each in places.items()}
    return frozenset(
        f"{kind} {place}" for kind in places for place in (*places[kind], *groups[kind])
    )


def _read(kind: type[_T], path: Path) -> _T:
    try:
        return kind.model_validate_json(_text(path))
    except ValidationError as error:
        raise InvalidInput(f"{path}: {explain(error, 'the file')}") from error


def _text(path: Path) -> str:
    try:
        return _content(path).decode()
    except UnicodeDecodeError as error:
        raise InvalidInput(f"{path} is no text: {error}") from error


def _content(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InvalidInput(f"{path} cannot be read: {error.strerror}") from error
