"""Films of runs' policies."""

import os
import sys
import threading
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait

import imageio_ffmpeg
import pytest

from adr_service.errors import InvalidInput
from adr_service.specs import RunSpec
from api.filming import Films, NoFilm
from tests.recordings import recording

SPEC = {"task": "arm", "method": "simopt", "preset": "smoke"}
FRICTION = {"kind": "joint_coulomb_friction", "location": "joint:elbow", "values": [0.1]}


@pytest.fixture
def films(tmp_path):
    return Films(tmp_path / "films")


def test_a_run_with_effects_beyond_the_tasks_simulator_has_no_film(films):
    for more in (
        {"extension": [FRICTION]},
        {"target": {"kind": "simulated", "effects": [FRICTION]}},
    ):
        with pytest.raises(InvalidInput, match="effects beyond it"):
            films.of(RunSpec.model_validate({**SPEC, **more}), b"", {})


def test_one_film_is_made_at_a_time(films, monkeypatch):
    begun, may_end = threading.Event(), threading.Event()

    def slowly(*_):
        begun.set()
        assert may_end.wait(30)
        return b"a film"

    monkeypatch.setattr(films, "_film", slowly)
    spec = RunSpec.model_validate(SPEC)
    first = threading.Thread(target=films.of, args=(spec, b"one", {}))
    first.start()
    assert begun.wait(30)
    with pytest.raises(NoFilm, match="ask again"):
        films.of(spec, b"another", {})
    may_end.set()
    first.join(30)
    assert films.of(spec, b"one", {}).read_bytes() == b"a film"  # it was kept


@pytest.fixture
def asked_twice(films, monkeypatch):
    """Asks for a film, and again while it is made; returns both requests once it has been made or
    has failed, and how often that was tried."""

    def ask(end):
        begun, may_end, tried = threading.Event(), threading.Event(), []

        def slowly(*_):
            tried.append(1)
            begun.set()
            assert may_end.wait(30)
            return end()

        monkeypatch.setattr(films, "_film", slowly)
        spec = RunSpec.model_validate(SPEC)
        with ThreadPoolExecutor(2) as threads:
            first = threads.submit(films.of, spec, b"one", {})
            assert begun.wait(30)
            second = threads.submit(films.of, spec, b"one", {})
            with pytest.raises(TimeoutError):
                second.result(0.1)
            may_end.set()
        return first, second, len(tried)

    return ask


def test_whoever_asks_for_the_film_that_is_being_made_waits_for_it(asked_twice):
    """A browser whose page is loaded again, for one."""
    first, second, tries = asked_twice(lambda: b"a film")
    assert second.result() == first.result()
    assert tries == 1


def test_no_more_than_two_hold_a_thread_for_the_film_that_is_being_made(films, monkeypatch):
    begun, may_end = threading.Event(), threading.Event()

    def slowly(*_):
        begun.set()
        assert may_end.wait(30)
        return b"a film"

    monkeypatch.setattr(films, "_film", slowly)
    spec = RunSpec.model_validate(SPEC)
    with ThreadPoolExecutor(6) as threads:
        first = threads.submit(films.of, spec, b"one", {})
        assert begun.wait(30)
        others = [threads.submit(films.of, spec, b"one", {}) for _ in range(5)]
        refused, _ = wait(others, 30, FIRST_COMPLETED)
        while len(refused) < 3:
            more, _ = wait(set(others) - refused, 30, FIRST_COMPLETED)
            assert more
            refused |= more
        may_end.set()
    for each in refused:
        with pytest.raises(NoFilm, match="the film is being made; ask again"):
            each.result()
    assert [each.result() for each in set(others) - refused] == [first.result()] * 2


def test_whoever_waited_for_a_film_that_could_not_be_made_does_not_make_it_again(asked_twice):
    def fail():
        raise InvalidInput("there is no film: no driver")

    first, second, tries = asked_twice(fail)
    with pytest.raises(InvalidInput, match="no driver"):
        first.result()
    with pytest.raises(NoFilm, match="could not be made"):
        second.result()
    assert tries == 1


def test_only_the_latest_films_stay_on_disk(films, monkeypatch):
    monkeypatch.setattr(films, "_film", lambda spec, policy, _: policy)
    monkeypatch.setattr("api.filming._MOST_KEPT", 2)
    spec = RunSpec.model_validate(SPEC)
    paths = []
    for number, policy in enumerate((b"one", b"two", b"three")):
        paths.append(films.of(spec, policy, {}))
        os.utime(paths[-1], (number, number))  # made one after the other
    assert [path.exists() for path in paths] == [False, True, True]
    assert paths[2].read_bytes() == b"three"


def test_a_film_that_is_asked_for_again_stays_longest(films, monkeypatch):
    monkeypatch.setattr(films, "_film", lambda spec, policy, _: policy)
    monkeypatch.setattr("api.filming._MOST_KEPT", 2)
    spec = RunSpec.model_validate(SPEC)
    paths = []
    for number, policy in enumerate((b"one", b"two")):
        paths.append(films.of(spec, policy, {}))
        os.utime(paths[-1], (number, number))  # made one after the other
    films.of(spec, b"one", {})
    films.of(spec, b"three", {})
    assert [path.exists() for path in paths] == [True, False]


def test_a_drawing_that_breaks_is_no_fault_of_the_request(films, monkeypatch, caplog):
    monkeypatch.setattr(films, "_drawn", lambda command: (-11, "the driver crashed"))
    with pytest.raises(NoFilm, match="the service's log says why"):
        films.of(RunSpec.model_validate(SPEC), b"one", {"parameters": []})
    assert "status -11: the driver crashed" in caplog.text


def test_closing_ends_the_drawing_that_goes_on(films, monkeypatch):
    """A service that stops waits for its threads."""
    asked, endless = threading.Event(), [sys.executable, "-c", "import time; time.sleep(90)"]
    draw = films._drawn

    def drawn(command):
        asked.set()
        return draw(endless)

    monkeypatch.setattr(films, "_drawn", drawn)
    with ThreadPoolExecutor(1) as threads:
        film = threads.submit(films.of, RunSpec.model_validate(SPEC), b"one", {"parameters": []})
        assert asked.wait(30)
        films.close()
        with pytest.raises(NoFilm, match="the service is stopping"):
            film.result(30)


def test_the_same_policy_on_another_kind_of_target_is_another_film(films, monkeypatch):
    monkeypatch.setattr(films, "_film", lambda spec, *_: spec.target.kind.encode())
    simulated = RunSpec.model_validate(SPEC)
    external = RunSpec.model_validate({**SPEC, "target": {"kind": "external"}})
    assert films.of(simulated, b"one", {}).read_bytes() == b"simulated"
    assert films.of(external, b"one", {}).read_bytes() == b"external"


def test_what_cannot_be_drawn_is_refused_with_the_reason(films):
    mean = {"task": "arm", "variant": "vanilla", "parameters": []}
    with pytest.raises(InvalidInput, match="not the bytes of a policy"):
        films.of(RunSpec.model_validate(SPEC), b"nonsense", mean)


@pytest.mark.slow
@pytest.mark.ray
@pytest.mark.parametrize("target", ["simulated", "recorded"])
def test_the_latest_policy_is_filmed_beside_the_target_if_that_is_simulated(
    service, target, tmp_path
):
    spec = SPEC | {"method": "dropo"}
    if target == "recorded":
        dataset = service.client.upload(recording("arm", 30).to_npz(), "arm")["id"]
        spec["target"] = {"kind": "recorded", "dataset": dataset}
    run = service.client.submit_run(spec)
    assert service.client.wait(run["id"], progress=False)["state"] == "succeeded"
    file = tmp_path / "film.mp4"
    file.write_bytes(service.client.content(f"/v1/runs/{run['id']}/film.mp4"))
    about = imageio_ffmpeg.read_frames(file)
    assert next(about)["size"][0] == {"simulated": 960, "recorded": 480}[target]
    about.close()
