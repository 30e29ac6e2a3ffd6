"""The pages in a browser: at three widths, light and dark, by mouse and without scripts."""

import json
import re

import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import expect

from adr_service.blind_test.planting import draw_case
from tests.api.page.addresses import LISTS
from tests.hidden import arm, recorded

pytestmark = [pytest.mark.slow, pytest.mark.ray, pytest.mark.browser]
SERIOUS = {"serious", "critical"}


@pytest.fixture
def addresses(benchmark, finished):
    own = [f"/benchmarks/{benchmark}", f"/runs/{finished}", f"/runs/{finished}/cost"]
    return [*LISTS, *own, f"/compare?id={benchmark}"]


def serious(page):
    """Findings of axe-core that keep people from using the page."""
    found = Axe().run(page).response["violations"]
    return [f"{f['id']}: {f['nodes'][0]['html']}" for f in found if f["impact"] in SERIOUS]


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1440, 768, 390])
def test_every_page_can_be_read_and_does_not_scroll_sideways(opened, addresses, width, scheme):
    page = opened("/", width, scheme)
    for address in addresses:
        page.goto(address)
        assert serious(page) == [], address
        assert page.evaluate("document.documentElement.scrollWidth") <= width, address
        assert page.locator("h1").count() == 1


def test_without_scripts_nothing_is_missing_but_sorting_and_curves(opened, addresses):
    page = opened("/", java_script_enabled=False)
    for address in addresses:
        page.goto(address)
        expect(page.locator("h1")).to_be_visible()
    page.goto("/submit")
    page.get_by_role("button", name="What does it cost?").click()
    expect(page.get_by_text("environment steps, at most")).to_be_visible()


def test_a_benchmark_from_the_form_is_followed_to_its_figures(opened):
    page = opened("/submit")
    methods = page.get_by_role("group", name="Methods", exact=True)
    methods.get_by_label("simopt", exact=True).uncheck()
    methods.get_by_label("dropo", exact=True).uncheck()
    methods.get_by_label("sysid", exact=True).check()
    page.get_by_label("Seeds").fill("90")
    page.get_by_label("Preset").select_option("smoke")
    page.get_by_role("button", name="What does it cost?").click()
    expect(page.get_by_text("on a core")).to_be_visible()
    page.get_by_role("button", name="Start it").click()
    expect(page).to_have_url(re.compile("/benchmarks/bench_"))
    expect(page.locator("#live").get_by_text("3 succeeded")).to_be_visible(timeout=120_000)
    # what it shows came without loading the page again, and it has stopped asking
    expect(page.locator("#live[hx-trigger]")).to_have_count(0)
    asked = []
    page.on("request", lambda request: asked.append(request.url))
    page.wait_for_timeout(6000)
    assert page.url not in asked
    expect(page.locator("figure img").first).to_be_visible()
    assert page.locator("figure img").first.evaluate("i => i.complete && i.naturalWidth > 0")


def test_a_wrong_benchmark_is_explained_beside_what_was_filled_in(opened):
    page = opened("/submit")
    page.get_by_label("Changed settings").fill("iterations=none\nno_such=1")
    page.get_by_role("button", name="Start it").click()
    alert = page.get_by_role("alert")
    expect(alert).to_contain_text("no_such")
    expect(page.get_by_label("Changed settings")).to_have_value("iterations=none\nno_such=1")


def test_tables_sort_by_any_column_and_filter(opened, benchmark):
    page = opened(f"/benchmarks/{benchmark}")
    names = page.locator("#final thead th").all_inner_texts()
    place = [name.strip() for name in names].index("return / threshold") + 1
    column = page.locator(f"#final tbody tr td:nth-child({place})")
    page.locator("#final").get_by_role("button", name="return / threshold").click()
    rising = [float(text.split()[0]) for text in column.all_inner_texts()]
    page.locator("#final").get_by_role("button", name="return / threshold").click()
    falling = [float(text.split()[0]) for text in column.all_inner_texts()]
    assert rising == sorted(rising)
    assert falling == sorted(falling, reverse=True)
    page.get_by_label("method").select_option("dropo")
    assert page.locator("#final tbody tr:visible").count() == 1


def test_learning_curves_grow_while_a_policy_is_trained(opened, service):
    spec = {"task": "arm", "method": "prior", "preset": "demo", "seed": 91}
    long = {"stop_at_threshold": False, "max_steps": 2_000_000}  # it is cancelled before
    run = service.client.submit_run({**spec, "training": long})["id"]
    page = opened(f"/runs/{run}")
    expect(page.locator("#curves canvas")).to_be_visible(timeout=60_000)
    expect(page.locator("#curves .u-legend")).to_contain_text("training 1")
    page.get_by_role("button", name="Cancel").click()
    expect(page.get_by_role("button", name="Resume")).to_be_visible(timeout=60_000)
    expect(page.locator("#curves canvas")).to_be_visible()  # the refreshes have left it


def test_a_ticked_benchmark_stays_ticked_when_another_one_comes(opened, service, benchmark):
    spec = {"tasks": ["arm"], "methods": ["udr"], "seeds": [92], "preset": "demo"}
    first = service.client.submit_benchmark(spec)["id"]
    page = opened("/")
    page.get_by_label(f"compare {benchmark}").check()
    second = service.client.submit_benchmark({**spec, "seeds": [93]})["id"]
    expect(page.get_by_label(f"compare {second}")).to_be_visible(timeout=30_000)
    for id in (first, second):
        expect(page.get_by_label(f"compare {id}")).not_to_be_checked()
        service.client.cancel(id)
    expect(page.get_by_label(f"compare {benchmark}")).to_be_checked()


def test_a_criticism_from_upload_to_report(opened, tmp_path):
    hidden = draw_case(*arm(), np.random.default_rng(101), 0.3)  # a gain, which can be trained on
    path = tmp_path / "arm.npz"
    np.savez(path, **recorded(hidden.measurement.episodes(range(12))))
    page = opened("/criticisms")
    page.get_by_label("Measurement").set_input_files(path)
    page.get_by_role("button", name="Criticise").click()
    expect(page.locator("h2", has_text="Verdict")).to_be_visible(timeout=240_000)
    expect(page.get_by_role("cell", name=hidden.effects[0].kind)).to_be_visible()
    criticism = page.url
    page.get_by_label("Train on the extended simulator by").select_option("udr")
    page.get_by_label("preset").select_option("smoke")
    page.get_by_role("button", name="Submit the run").click()
    expect(page.locator("#live")).to_contain_text("succeeded", timeout=120_000)
    page.goto(criticism)
    page.get_by_role("link", name="report.html").click()
    expect(page.locator("svg").first).to_be_visible()


def test_a_file_that_is_no_measurement_is_explained(opened, tmp_path):
    path = tmp_path / "wrong.npz"
    path.write_bytes(b"nothing")
    page = opened("/criticisms")
    page.get_by_label("Measurement").set_input_files(path)
    page.get_by_role("button", name="Criticise").click()
    expect(page.get_by_role("alert")).to_be_visible()


def test_a_run_that_waits_for_a_robot_says_so(opened, service):
    spec = {"task": "arm", "method": "simopt", "preset": "smoke", "seed": 92}
    run = service.client.submit_run({**spec, "target": {"kind": "external"}})["id"]
    page = opened(f"/runs/{run}")
    expect(page.locator("#live")).to_contain_text("It waits for a robot", timeout=120_000)
    page.get_by_role("link", name="robot").first.click()
    expect(page.locator("#list")).to_contain_text(run)
    service.client.cancel(run)


def test_a_refused_refresh_leaves_the_page_and_is_asked_again(opened, service):
    training = {"max_steps": 1_000_000, "stop_at_threshold": False}
    spec = {"task": "arm", "method": "prior", "preset": "smoke", "seed": 93, "training": training}
    run = service.client.submit_run(spec)["id"]
    page = opened(f"/runs/{run}")
    answers = []

    def refuse_once(route):
        answers.append(1)
        route.fulfill(status=503, body="later") if len(answers) == 1 else route.continue_()

    page.route(f"**/runs/{run}", refuse_once)
    stale = page.get_by_text("the service answers 503.")
    expect(stale).to_be_visible(timeout=12_000)
    expect(page.locator("#live h2").first).to_be_visible()
    expect(stale).to_have_count(0, timeout=12_000)
    assert len(answers) >= 2
    expect(page.locator("#live h2").first).to_be_visible()
    service.client.cancel(run)


def test_a_page_says_that_its_service_does_not_answer(chromium, service):
    context = chromium.new_context(base_url=service.client.url)
    page = context.new_page()
    page.goto("/robots")
    page.route("**/robots", lambda route: route.abort())
    expect(page.get_by_text("the service does not answer.")).to_be_visible(timeout=12_000)
    context.close()


def test_a_form_is_submitted_once_however_often_one_clicks(opened):
    page = opened("/submit")
    asked = []

    def answer(route):
        asked.append(route.request.post_data)
        route.fulfill(status=204)  # after which a browser stays where it is

    page.route("**/submit", answer)
    button = page.get_by_role("button", name="Start it")
    button.dblclick()
    button.click()
    page.wait_for_timeout(500)
    assert len(asked) == 1
    assert "act=start" in asked[0]


def test_the_link_that_has_the_focus_keeps_it_through_refreshes(opened, service, finished):
    """A sorted table puts its rows into their order again."""
    other = service.client.submit_run({"task": "arm", "method": "prior", "preset": "smoke"})["id"]
    page = opened("/")
    page.locator("#runs").get_by_role("button", name="run", exact=True).click()
    for run in (other, finished):
        page.get_by_role("link", name=run).focus()
        with page.expect_response(re.compile("/$"), timeout=40_000):
            pass
        page.wait_for_timeout(500)
        assert page.evaluate("document.activeElement.textContent") == run


def test_the_reason_why_there_is_no_film_is_told(opened, finished):
    page = opened(f"/runs/{finished}")
    refusal = {"detail": "another film is being made"}
    page.route("**/film.mp4*", lambda route: route.fulfill(status=503, json=refusal))
    page.locator("video").evaluate("film => { film.play().catch(() => {}) }")
    expect(page.get_by_text("No film: another film is being made.")).to_be_visible()


def test_learning_curves_become_as_narrow_as_the_window(opened, finished):
    page = opened(f"/runs/{finished}")
    expect(page.locator("#curves canvas")).to_be_visible()
    page.set_viewport_size({"width": 390, "height": 800})
    fits = "document.documentElement.scrollWidth <= 390"
    page.wait_for_function(fits)


def test_columns_of_times_sort_too(opened, service, finished):
    other = service.client.submit_run({"task": "arm", "method": "prior", "preset": "smoke"})["id"]
    page = opened("/")
    page.locator("#runs").get_by_role("button", name="run", exact=True).click()
    ids = page.locator("#runs tbody td:first-child").all_inner_texts()
    assert {other, finished} <= set(ids)
    assert ids == sorted(ids)
    page.locator("#runs").get_by_role("button", name="changed").click()
    times = page.locator("#runs tbody time").all_inner_texts()
    assert times == sorted(times)


def test_an_unknown_address_is_a_page_for_people_and_json_for_programs(chromium, service, http):
    context = chromium.new_context(base_url=service.client.url)
    page = context.new_page()
    assert page.goto("/runs/run_0").status == 404
    expect(page.locator("h1")).to_have_text("Not found")
    context.close()
    assert json.loads(http.get("/runs/run_0").text)["status"] == 404
