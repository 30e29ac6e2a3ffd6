"""The pages for browsers."""

import html
import re
import sqlite3
from contextlib import closing

import pytest

from api.page.benchmarks import best_of, final_rows
from tests.api.smoke import SMOKE
from tests.benchmark.test_claims import outcome
from tests.recordings import recording
from tests.service import until

pytestmark = pytest.mark.ray


def test_the_page_of_a_benchmark_shows_its_figures(http, benchmark):
    page = http.get(f"/benchmarks/{benchmark}").text
    assert "dropo" in page
    for name in ("returns.svg", "spread.png", "cost.csv"):
        assert f"/v1/benchmarks/{benchmark}/figures/{name}" in page
    assert shown_figure(page, benchmark) == len(iterations_of(http, benchmark))
    assert "these numbers mean nothing" in page
    assert benchmark in http.get("/").text


def shown_figure(page, benchmark):
    """The number that makes a browser load the figure again."""
    pattern = rf'<img src="/v1/benchmarks/{benchmark}/figures/returns.svg\?renewed=(\d+)"'
    return int(re.search(pattern, page)[1])


def iterations_of(http, benchmark):
    """Run and number of every finished iteration."""
    runs = [run["id"] for run in http.get(f"/v1/benchmarks/{benchmark}").json()["runs"]]
    return [
        (run, estimate["iteration"])
        for run in runs
        for estimate in http.get(f"/v1/runs/{run}/results").json()["rows"]
    ]


@pytest.mark.parametrize(
    ("address", "said"),
    [
        ("/submit", "Submit a benchmark"),
        ("/compare", "Tick benchmarks in the"),
        ("/criticisms", "No simulator has been criticised here yet"),
        ("/robots", "Visits to targets outside of this service"),
        ("/datasets", "Recordings of transitions"),
        ("/claims", "The paper’s claims"),
        ("/docs", "/v1/benchmarks"),
        ("/docs", "a method&#39;s name, or its settings with"),
    ],
)
def test_every_page_answers_and_says_what_is_there(http, address, said):
    answer = http.get(address)
    assert answer.status_code == 200
    assert said in answer.text


@pytest.mark.parametrize("address", ["/runs", "/benchmarks", "/login"])
def test_an_address_that_one_may_guess_leads_to_the_first_page(http, address):
    answer = http.get(address)
    assert (answer.status_code, answer.headers["Location"]) == (303, "/")


def test_a_browser_asks_each_time_whether_a_script_has_changed(http):
    """A page of a new version with a script of an old one does what neither should."""
    script = http.get("/static/page.js")
    assert script.headers["Cache-Control"] == "no-cache"
    tag = {"If-None-Match": script.headers["ETag"]}
    assert http.get("/static/page.js", headers=tag).status_code == 304


@pytest.mark.slow
def test_a_film_is_sent_in_parts_to_players_that_ask_for_them(http, finished):
    film = http.get(f"/v1/runs/{finished}/film.mp4", headers={"Range": "bytes=0-99"})
    if film.status_code == 422:
        pytest.skip(f"nothing can be drawn here: {film.json()['detail']}")
    assert film.status_code == 206
    assert len(film.content) == 100
    assert film.headers["Content-Range"].startswith("bytes 0-99/")


@pytest.mark.parametrize(
    ("where", "option"),
    [("127.0.0.1:8000", ""), ("127.0.0.1:8123", " --url http://127.0.0.1:8123")],
)
def test_the_commands_of_a_page_go_to_the_service_that_shows_it(http, where, option):
    page = http.get("/submit", headers={"host": where}).text
    assert f"<code>adr submit spec.json{option}</code>" in page


def test_a_benchmark_has_its_best_first_its_runs_and_how_to_repeat_it(http, benchmark):
    page = http.get(f"/benchmarks/{benchmark}").text
    order = [
        page.index(f"<h2{more}>{name}")
        for more, name in (
            (' id="leaderboard"', "Leaderboard"),
            ("", "Figures"),
            ("", "Runs"),
            ("", "How to repeat it"),
        )
    ]
    assert order == sorted(order)
    assert "Probability of improvement" not in page  # of one seed
    for run in http.get(f"/v1/benchmarks/{benchmark}").json()["runs"]:
        assert f'href="/runs/{run["id"]}"' in page
    few = r'data-value="[-\d.e]+">-?\d+\.\d\d<br><span class="note">too few seeds for an interval<'
    assert re.search(few, page)
    assert f"/v1/benchmarks/{benchmark}/archive" in page
    compared = http.get("/compare", params={"id": [benchmark, benchmark]}).text
    assert re.search(few, compared)
    assert compared.count(">dropo<") == 1
    assert ">smoke<" in compared
    figure = f"/v1/benchmarks/{benchmark}/figures/returns.svg"
    assert http.get(figure, params={"renewed": 3}).status_code == 200
    assert http.get(figure, params={"renew": 3}).status_code == 422


def test_a_comparison_names_what_it_lacks(http, benchmark):
    slow = {**SMOKE, "method": "prior", "seed": 82, "target": {"kind": "external"}}
    run = http.post("/v1/runs", json=slow).json()["id"]
    shown = http.get("/compare", params={"id": [benchmark, run]}).text
    assert f"No policy of these has been evaluated yet: {run}." in shown
    assert ">dropo<" in shown
    page = http.get(f"/runs/{run}").text
    assert f'href="/v1/runs/{run}/policy"' not in page
    assert f'href="/v1/runs/{run}/distribution"' not in page
    assert f'href="/v1/runs/{run}/events"' in page
    http.post(f"/v1/runs/{run}/cancel")


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"task": "hopper"}, "the data have 4 observations and 2 actions; hopper measures 11"),
        ({"task": "arm"}, "40 transitions in 1 episodes are too few"),
        ({"task": "amr"}, "did you mean"),
        ({"variant": "loud"}, "variant"),
    ],
)
def test_data_that_do_not_fit_are_refused_beside_the_form_and_not_stored(http, given, said):
    before = http.get("/v1/datasets").json()
    files = {"measurement": recording("arm", 40).to_npz()}
    answer = http.post(
        "/criticisms", data={"task": "arm", "variant": "vanilla", **given}, files=files
    )
    assert answer.status_code == 422
    page = html.unescape(answer.text)
    assert said in page
    assert "Choose the file again" in page
    assert "<option selected>arm" in page or given.get("task", "arm") != "arm"
    assert http.get("/v1/datasets").json() == before


def test_a_wrong_task_is_named_before_the_file_is_read(http):
    answer = http.post(
        "/criticisms", data={"task": "amr", "variant": "vanilla"}, files={"measurement": b"x"}
    )
    assert answer.status_code == 422
    assert "did you mean" in html.unescape(answer.text)
    assert "Choose the file again" not in http.get("/criticisms").text


def test_a_form_submits_what_it_priced(http):
    form = {
        "tasks": "arm",
        "methods": "sysid",
        "variants": "vanilla",
        "collectors": "simopt",
        "seeds": "81",
        "preset": "smoke",
        "settings": "iterations=1",
    }
    priced = http.post("/submit", data={**form, "act": "plan"}).text
    for bounded in ("environment steps", "computing", r"time, with \d+ cores?"):
        assert re.search(rf"{bounded}, at most</dt>", priced)
    refused = http.post("/submit", data={**form, "seeds": "81, x", "act": "start"})
    assert refused.status_code == 422
    assert "given &#39;x&#39;" in refused.text
    started = http.post("/submit", data={**form, "act": "start"})
    assert started.status_code == 303
    id = started.headers["Location"].rsplit("/")[-1]
    spec = http.get(f"/v1/benchmarks/{id}").json()["spec"]
    assert (spec["methods"], spec["seeds"], spec["iterations"]) == (["sysid"], [81], 1)
    assert "of computing" in http.get(f"/benchmarks/{id}/left").text
    again = http.get("/submit", params={"like": id}).text
    assert 'value="81"' in again
    assert "iterations=1" in again
    assert http.post(f"/benchmarks/{id}/cancel").status_code == 303
    until(lambda: http.get(f"/v1/benchmarks/{id}").json()["is_finished"])
    assert 'action="/benchmarks/' + id + '/resume"' in http.get(f"/benchmarks/{id}").text


def test_the_page_of_a_run_shows_its_events(http, finished):
    page = http.get(f"/runs/{finished}").text
    assert re.search(r"iteration_finished</td><td>iteration \d, \d+ transitions seen, target", page)
    left = re.search(r"(\d+) more were asked for before", page)  # by a run that shares its stages
    assert page.count('<rect class="computes"') + int(left[1] if left else 0) > 2
    assert "safetensors</a>" in page
    assert f"/v1/runs/{finished}/figures/returns.svg" in page
    assert f'href="/v1/runs/{finished}/policy"' in page
    assert f"/v1/runs/{finished}/film.mp4?renewed=" in page
    assert re.search(r'<text class="seconds" [^>]*>\d+\.\d s</text>', page)
    assert f'href="/runs/{finished}"' in http.get("/").text
    assert http.get("/runs/run_0").status_code == 404


def test_the_cost_of_a_run_and_of_a_benchmark_is_a_table_for_people(http, finished, benchmark):
    for page in (f"/runs/{finished}", f"/benchmarks/{benchmark}"):
        assert f'href="{page}/cost">cost</a>' in http.get(page).text
        cost = http.get(f"{page}/cost").text
        assert re.search(r"<td>train_policy</td><td class=\"number\">\d", cost)
        assert f'href="/v1{page}/cost"' in cost
    assert http.get("/runs/run_0/cost").status_code == 404


def test_the_page_of_a_run_shows_how_its_inference_ended(http, benchmark):
    """The loss, and parameters at their limits."""
    runs = http.get(f"/v1/benchmarks/{benchmark}").json()["runs"]
    run = next(each["id"] for each in runs if each["spec"]["method"]["name"] == "dropo")
    facts = http.get(f"/v1/runs/{run}/distribution").json()["diagnostics"]
    page = http.get(f"/runs/{run}").text
    assert f"{facts['loss_per_window']:.3f}" in page
    inference = page.split("<h2>Inference</h2>")[1].split("<h2>Events</h2>")[0]
    assert all(name in inference for name in facts["at_bound"] + facts["widest"])


def test_what_cannot_be_read_any_more_is_shown_beside_the_rest(service, http):
    spec = {"task": "arm", "method": "udr", "preset": "smoke", "seed": 95}
    run = http.post("/v1/runs", json=spec).json()["id"]
    until(lambda: http.get(f"/v1/runs/{run}").json()["state"] == "succeeded")
    with closing(sqlite3.connect(service.data_dir / "adr.sqlite")) as file, file:
        change = "UPDATE runs SET spec = replace(spec, ?, ?) WHERE id = ?"
        file.execute(change, ['"udr"', '"median_best"', run])
    for address in ("/", "/claims", f"/runs/{run}", "/v1/runs", f"/compare?id={run}"):
        assert http.get(address).status_code == 200, address
    assert "is not installed here" in html.unescape(http.get(f"/runs/{run}").text)
    assert http.delete(f"/v1/runs/{run}").status_code == 204


def test_a_running_stage_links_to_its_actor_in_rays_dashboard(service, http):
    # there until it is cancelled
    training = {"max_steps": 1_000_000, "stop_at_threshold": False}
    long = {**SMOKE, "method": "prior", "seed": 80, "training": training}
    run = service.client.submit_run(long)["id"]
    link = re.compile(r'href="(http://\S+)/#/actors/\w{32}">adr:run_\w+:trainer:[0-9a-f]{6}-\d+<')
    found = until(lambda: link.search(http.get(f"/runs/{run}").text))
    assert found.group(1) == http.get("/readyz").json()["dashboard"]
    http.post(f"/v1/runs/{run}/cancel")


def test_a_run_that_waits_for_a_robot_says_so(service, http):
    spec = {**SMOKE, "target": {"kind": "external"}, "evaluation_episodes": 12, "seed": 81}
    run = service.client.submit_run(spec)["id"]
    wait = r'It waits for a <a href="/robots">robot</a>: (.*), and more\.</p>'
    found = until(lambda: re.search(wait, http.get(f"/runs/{run}").text))
    # no stage is computed, and yet it goes on
    assert 'hx-get="/" hx-trigger="every 5s"' in http.get("/").text
    http.post(f"/v1/runs/{run}/cancel")
    waiting = [f"evaluation {number} is pending" for number in range(10)]
    assert found[1] == ", ".join(waiting)


def test_a_leaderboard_has_what_is_compared():
    def row(found):
        spec = found.spec
        place = (spec.task, spec.variant, spec.method.name, spec.collector)
        names = ("task", "variant", "method", "collector", "iteration", "normalised_return")
        return dict(zip(names, (*place, found.iteration.iteration, 1.0), strict=True))

    both = ("simopt", "dropo")
    done = [outcome(1.0, method=name, iteration=number) for name in both for number in range(3)]
    begun = [outcome(1.0, method="bayrn", iteration=number) for number in range(2)]
    found = [*done, *begun, outcome(1.0, method="oracle", iteration=0)]
    rows = [row(each) for each in found]
    final = final_rows(rows, found)
    iterations = {each["method"]: each["iteration"] for each in final}
    assert iterations == {"dropo": 2, "simopt": 2, "oracle": 0}


def test_only_methods_that_can_be_compared_are_marked_as_best():
    def row(method, value, low=0.0):
        place = {"task": "arm", "variant": "vanilla", "method": method}
        return {**place, "normalised_return": value, "low": low}

    ahead, behind = row("dropo", 1.0), row("simopt", 0.9)
    oracle, few = row("oracle", 1.3), row("droid", 1.1, low=None)
    assert best_of([oracle, few, ahead, behind]) == [ahead]
    assert best_of([oracle, few]) == []
    uninstalled = row("median_best", 9.0)
    assert best_of([uninstalled, ahead]) == [ahead]
