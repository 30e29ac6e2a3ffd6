"""A measurement hides an effect, and criticism names it; or hides none, and criticism says so."""

import io
import json
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from rich.console import Console
from typer.testing import CliRunner

from adr_service.criticism.compatibility import check_measurement
from adr_service.criticism.decision import THRESHOLD, decide, is_unknown
from adr_service.criticism.evidence import fit, smoothed
from adr_service.criticism.experiments import separating_experiment
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.nominal import Nominal
from adr_service.criticism.pipeline import criticise
from adr_service.criticism.remarks import on_commands
from adr_service.criticism.responses import Responses
from adr_service.criticism.scan import scan
from adr_service.criticism.sensor_spread import lattice
from adr_service.criticism.simulator import Simulator
from adr_service.effects.base import Effect
from adr_service.errors import InvalidInput
from adr_service.parameters import Parameter, ParameterSpace
from adr_service.tasks.catalogue import get_task
from api.cli import app
from api.cli.verdict_table import verdict_table
from benchmarks.planted import draw_case, hide
from tests.hidden import arm, recorded

# frozen before any threshold was chosen: the seeds of a battery on the small task
BATTERY = range(100, 106)


def case(seed, ratio=0.3, **how):
    return draw_case(*arm(), np.random.default_rng(seed), ratio, **how)


@pytest.mark.parametrize(
    "seed", [*BATTERY[:4], *(pytest.param(seed, marks=pytest.mark.slow) for seed in BATTERY[4:])]
)
def test_a_hidden_effect_is_named_or_tied_with_what_equals_it(seed):
    hidden = case(seed)
    found = criticise(hidden.nominal, hidden.measurement, np.random.default_rng(0), threads=1)
    verdict, (cause,) = found.verdict, hidden.effects
    assert verdict.conclusion in ("cause", "tie")
    assert len(verdict.causes) == 1
    named = {(c.kind, c.location) for c in (verdict.causes[0], *verdict.tied[0])}
    assert (cause.kind, cause.location) in named
    assert verdict.gain.low < verdict.gain.sse_removed < verdict.gain.high


@pytest.mark.parametrize("seed", [200, 201])
def test_where_nothing_is_hidden_nothing_is_found_but_detection_limits(seed):
    hidden = case(seed, count=0)
    found = criticise(hidden.nominal, hidden.measurement, np.random.default_rng(0), threads=1)
    assert found.verdict.conclusion == "none"
    assert found.extension is None
    assert found.verdict.gain is None
    limits = found.verdict.residual.detectable
    size, unit = limits["joint_coulomb_friction joint:elbow"]
    assert (0 < size < 0.1, unit) == (True, "N m")  # of a motor of 12
    # the parameters were off by up to 10 %, and are found
    np.testing.assert_allclose(found.final.parameters, hidden.truth, rtol=0.01)


@pytest.mark.parametrize(
    ("seed", "ratio", "effect"), [(300, 1.0, "gain_drift"), (312, 0.3, "disturbance")]
)
def test_an_effect_that_is_not_in_the_catalogue_is_called_unknown(seed, ratio, effect):
    hidden = case(seed, ratio=ratio, outside=True)
    assert hidden.outside == effect
    found = criticise(hidden.nominal, hidden.measurement, np.random.default_rng(0), threads=1)
    assert found.verdict.conclusion == "unknown"
    assert not found.verdict.causes


@pytest.fixture(scope="module")
def good():
    """A measurement with nothing wrong."""
    return recorded(case(1, count=0).measurement)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """The file of a measurement that hides an effect, short to be fast."""
    path = tmp_path_factory.mktemp("data") / "arm.npz"
    np.savez(path, **recorded(case(100).measurement.episodes(range(12))))
    return path


class TestDecision:
    """Rules alone, on gains by episode."""

    NOTHING = np.zeros(20)

    def decide(self, gains):
        return decide(np.array(gains), np.random.default_rng(0))

    def test_a_gain_below_the_threshold_is_chance(self):
        gains = np.full(20, 0.9 * THRESHOLD / 20)
        assert not self.decide([gains]).alike

    def test_a_gain_that_hangs_on_one_episode_is_chance(self):
        gains = self.NOTHING.copy()
        gains[3] = 10 * THRESHOLD
        assert not self.decide([gains]).alike

    def test_the_best_that_is_more_than_chance_is_named_beside_a_larger_one_that_is_not(self):
        flaky = np.full(20, -0.5)
        flaky[:2] = 60.0
        found = self.decide([flaky, np.full(20, 4.0)])
        assert found.alike == (1,)
        assert found.confidence[1] > 0.99

    def test_what_few_episodes_show_clearly_is_evidence(self):
        gains = self.NOTHING.copy()
        gains[:3] = 100.0
        assert self.decide([gains]).alike == (0,)

    def test_no_candidate_at_all_is_none(self):
        assert not self.decide(np.empty((0, 20))).alike

    def test_the_better_of_two_is_named_with_all_confidence(self):
        found = self.decide([np.full(20, 2.0), np.full(20, 5.0)])
        assert found.alike == (1,)
        assert found.confidence[1] > 0.99

    def test_two_that_differ_by_less_than_their_difference_varies_are_tied(self):
        noise = np.random.default_rng(1).normal(0, 3, 20)
        found = self.decide([5 + noise, np.full(20, 5.2)])
        assert set(found.alike) == {0, 1}

    def test_what_a_flexible_force_explains_beside_a_cause_decides_whether_that_is_it(self):
        flexible = np.full(20, 9.0)
        assert is_unknown(flexible, named=100.0)
        assert not is_unknown(flexible, named=2000.0)
        assert not is_unknown(np.full(20, 1.0), named=0.0)  # chance


class TestBadInput:
    """What is wrong, at which row, and what is needed."""

    @pytest.mark.parametrize(
        ("name", "change", "message"),
        [
            ("qvel", lambda a: a[:-1], "qvel has shape .* expected are 2280 rows"),
            ("qpos", lambda a: np.where(np.arange(len(a))[:, None] == 5, np.nan, a), "row 5"),
            ("episode", lambda a: a[::-1], "must not decrease; they do at row 76"),
            ("episode", lambda a: a.astype(float), "whole numbers"),
            ("time", lambda a: a[:, None], "in 1 dimension"),
            (
                "time",
                lambda a: np.where(np.arange(len(a)) == 7, a - 0.1, a),
                "time must increase within an episode; it goes from 0.12 to 0.04 s at row 7",
            ),
            ("time", np.zeros_like, "time must increase"),
        ],
    )
    def test_arrays_that_do_not_fit(self, good, name, change, message):
        with pytest.raises(InvalidInput, match=message):
            Measurement(**{**good, name: change(good[name])})

    @pytest.mark.parametrize(
        ("name", "change", "message"),
        [
            ("time", lambda a: np.where(np.arange(len(a)) == 7, a - 0.01, a), "from row 6 to 7"),
            ("time", lambda a: 1000 * a, "2000 of the model's steps; accepted are 500 at most"),
            ("time", lambda a: 1.3 * a, "no multiple of the model's step of 0.01"),
            ("ctrl", lambda a: a[:, :1], "ctrl has 1 columns; the model has 2"),
        ],
    )
    def test_measurements_that_no_simulation_can_follow(self, good, name, change, message):
        measurement = Measurement(**{**good, name: change(good[name])})
        with pytest.raises(InvalidInput, match=message):
            Simulator(arm()[1], measurement)

    @pytest.mark.parametrize(
        ("xml", "message"),
        [
            ("<mujoco><nonsense/></mujoco>", "MuJoCo cannot read the model"),
            (
                '<mujoco><worldbody><body><joint type="slide"/></body></worldbody></mujoco>',
                "compile",
            ),
            (
                '<mujoco><compiler settotalmass="2"/><worldbody><body><joint type="slide"/>'
                '<geom size="1"/></body></worldbody></mujoco>',
                "settotalmass",
            ),
            (
                '<mujoco><worldbody><body><freejoint/><geom size="1"/></body></worldbody></mujoco>',
                "free and ball joints",
            ),
        ],
    )
    def test_models_that_cannot_be_criticised(self, good, xml, message):
        with pytest.raises(InvalidInput, match=message):
            Simulator(Nominal.of_model(xml, ParameterSpace(())), Measurement(**good))

    def test_a_start_outside_of_the_bounds(self):
        space = ParameterSpace((Parameter("mass", "body:fore.mass", "kg", 2.0, 3.0, 2.0),))
        with pytest.raises(InvalidInput, match=r"the model has 0\.7 for mass, .* bounds: 2 to 3"):
            Nominal.of_model(get_task("arm").xml, space)

    @pytest.mark.parametrize(
        ("name", "change", "message"),
        [
            ("time", lambda a: 2 * a, "column 0 of qpos moves 0.5 times as far as"),
            ("qvel", np.degrees, "qpos moves 0.0175 times as far"),
        ],
    )
    def test_velocities_that_are_not_the_rates_of_positions(self, good, name, change, message):
        measurement = Measurement(**{**good, name: change(good[name])})
        with pytest.raises(InvalidInput, match=message):
            criticise(arm()[1], measurement, np.random.default_rng(0))

    def test_no_rows_at_all(self, good):
        with pytest.raises(InvalidInput, match="has no rows"):
            Measurement(**{name: values[:0] for name, values in good.items()})

    def test_more_than_memory_holds(self):
        """One long episode among many short ones: all are padded to the longest."""
        short, long = 4000, 60_000
        rows = 2 * short + long
        measurement = Measurement(
            time=np.arange(rows) * 0.02,
            qpos=np.random.default_rng(0).standard_normal((rows, 2)),
            qvel=np.random.default_rng(1).standard_normal((rows, 2)),
            ctrl=np.zeros((rows, 2)),
            episode=np.append(np.repeat(np.arange(short), 2), np.full(long, short)),
        )
        with pytest.raises(InvalidInput, match="4001 episodes, the longest of 60000 rows"):
            check_measurement(arm()[1], measurement)

    def test_too_little_data(self, good):
        measurement = Measurement(**good).episodes(range(7))
        with pytest.raises(InvalidInput, match="in 7 episodes are too few"):
            criticise(arm()[1], measurement, np.random.default_rng(0))

    def test_an_episode_of_one_row(self, good):
        ids = good["episode"].copy()
        ids[-1] += 1
        with pytest.raises(InvalidInput, match="the episode at row 2279 has a single row"):
            Measurement(**{**good, "episode": ids})

    def test_a_simulation_that_diverges(self, good):
        wild = Measurement(**{**good, **{n: 1e12 * good[n] for n in ("qpos", "qvel")}})
        with pytest.raises(InvalidInput, match="the simulation diverges from"):
            criticise(arm()[1], wild, np.random.default_rng(0), threads=1)


def test_the_least_that_is_accepted_is_enough(good):
    """Eight episodes, of which two are sealed."""
    data = case(100).measurement.episodes(range(8))
    found = criticise(arm()[1], data, np.random.default_rng(0), threads=1)
    assert found.verdict.gain is not None
    assert found.verdict.residual.used == 6 * 75


def test_a_second_cause_is_found_beside_the_first():
    """The first looks like a group, `sensor:*`, until the second is known."""
    hidden = [
        Effect("sensor_delay", "sensor:shoulder.position", (0.0006,)),
        Effect("joint_armature", "joint:elbow", (0.0005,)),
    ]
    task, nominal = arm()
    data = hide(task, nominal, np.random.default_rng(400), hidden)
    found = criticise(
        nominal, data.episodes(range(20)), np.random.default_rng(0), threads=1
    ).verdict
    assert found.conclusion == "cause"
    assert len(found.causes) == 2
    for cause in hidden:
        (named,) = (n for n in found.causes if (n.kind, n.location) == (cause.kind, cause.location))
        assert named.strengths[0].value == pytest.approx(cause.values[0], rel=0.05)


def test_what_the_sealed_episodes_refute_is_not_named():
    """A spring in the episodes to learn from, the opposite of it in the sealed ones."""
    task, nominal = arm()
    stiff, soft = (
        recorded(
            hide(
                task,
                nominal,
                np.random.default_rng(402),
                [Effect("joint_spring", "joint:elbow", (k,))],
            )
        )
        for k in (0.5, -0.5)
    )
    is_sealed = stiff["episode"] % 4 == 3
    data = Measurement(
        **{name: np.where(is_sealed, soft[name].T, stiff[name].T).T for name in stiff}
    )
    found = criticise(nominal, data, np.random.default_rng(0), threads=1)
    assert found.verdict.conclusion == "unknown"  # by the flexible force
    assert "joint_spring joint:elbow" in found.verdict.remarks[0]
    assert not found.verdict.causes
    assert found.verdict.gain is None
    assert found.extension is None


def test_commands_that_say_nothing_and_commands_beyond_limits_are_told(good):
    model = arm()[1].model(arm()[1].start)
    assert on_commands(model, Measurement(**good)) == ()
    told = np.array(good["ctrl"])
    told[:, 0], told[:3, 1] = 0.25, -1.5
    still, beyond = on_commands(model, Measurement(**{**good, "ctrl": told}))
    assert still.startswith("The command to actuator shoulder is 0.25 all the time")
    assert beyond.startswith("3 of 2250 commands to actuator elbow are beyond its limits, -1 to 1")


def test_one_effect_at_all_places_is_a_group():
    """With a strength for each, where it explains more than any single place."""
    hidden = [
        Effect("joint_coulomb_friction", "joint:shoulder", (0.2,)),
        Effect("joint_coulomb_friction", "joint:elbow", (0.1,)),
    ]
    task, nominal = arm()
    data = hide(task, nominal, np.random.default_rng(401), hidden).episodes(range(12))
    sensor = data.sensor_variance()
    with Simulator(nominal, data, threads=1, finer=3) as simulator:
        baseline = smoothed(fit(simulator, sensor), sensor)
        best, *others = scan(baseline, Responses(baseline))
    assert (best.kind, best.location) == ("joint_coulomb_friction", "joint:*")
    assert best.gain > max(c.gain for c in others if len(c.effects) == 1) + THRESHOLD
    found = {cause.location: cause.values[0] for cause in best.effects}
    expected = {cause.location: cause.values[0] for cause in hidden}
    assert found == pytest.approx(expected, rel=0.3)  # to first order


def test_a_body_without_mass_moves_nothing(good):
    nominal = arm()[1]
    with Simulator(nominal, Measurement(**good), threads=1) as simulator:
        for gone in (
            Effect("body_mass", "body:fore", (-0.7,)),
            Effect("body_inertia", "body:fore", (-1.0,)),
        ):
            assert np.isnan(simulator.predict(nominal.start, [gone], simulator.measured)).all()


def test_commands_beyond_an_actuators_limits_are_what_it_obeys(good):
    wild = Measurement(**{**good, "ctrl": 3.0 * np.sign(good["ctrl"])})
    with Simulator(arm()[1], wild, threads=1) as simulator:
        told = simulator.commands([], simulator.steps)
        unmoved = Effect("actuator_deadband", "actuator:elbow", (0.0,))
        harmless = simulator.commands([unmoved], simulator.steps)
    assert np.abs(told).max() == 1.0
    np.testing.assert_array_equal(told, harmless)


@pytest.fixture(scope="module")
def clean():
    """An arm without any effect; noise of 1 mrad and 10 mrad/s."""
    task, nominal = arm()
    return recorded(hide(task, nominal, np.random.default_rng(403), []).episodes(range(12)))


class TestReadings:
    """What sensors do beside moving their readings."""

    def criticised(self, fields):
        return criticise(arm()[1], Measurement(**fields), np.random.default_rng(0), threads=1)

    def test_steps_are_seen_where_they_matter(self, clean):
        qpos = clean["qpos"].copy()
        qpos[:, 1] = 0.005 * np.round(qpos[:, 1] / 0.005)
        found = self.criticised({**clean, "qpos": qpos})
        (cause,) = found.verdict.causes
        assert (cause.kind, cause.location) == ("sensor_quantisation", "sensor:elbow.position")
        assert cause.strengths[0].value == pytest.approx(0.005, rel=1e-9)
        assert (found.verdict.conclusion, found.verdict.gain) == ("cause", None)
        assert [c.kind for c in found.extension.beside] == ["sensor_quantisation"]
        console = Console(width=200, record=True, file=io.StringIO())
        console.print(verdict_table(found.verdict.to_json()))
        assert "sensor_quantisation" in console.export_text()

    def test_more_noise_than_was_said_is_seen(self, clean):
        """The elbow's velocity is said to have half of the noise that it has."""
        said = {"qpos_std": np.full(2, 1e-3), "qvel_std": np.array([0.01, 0.005])}
        (cause,) = self.criticised({**clean, **said}).verdict.causes
        assert (cause.kind, cause.location) == ("sensor_noise", "sensor:elbow.velocity")
        assert cause.strengths[0].low < np.sqrt(0.01**2 - 0.005**2) < cause.strengths[0].high

    def test_the_last_digits_of_a_file_are_no_steps(self, clean):
        rounded = {**clean, "qpos": np.round(clean["qpos"], 4)}
        assert self.criticised(rounded).verdict.conclusion == "none"

    def test_a_lattice_is_measured_to_the_last_digits(self):
        readings = 0.3 + 2 * np.pi / 4096 * np.random.default_rng(0).integers(-50, 50, 2000)
        assert lattice(readings) == pytest.approx(2 * np.pi / 4096, rel=1e-12)
        assert lattice(np.random.default_rng(0).standard_normal(2000)) is None
        assert lattice(np.repeat([0.0, 2.0, 5.0, 7.0, 9.0, 12.0], 9)) == 1.0
        odd = np.append(readings, 0.30001 + readings[:1000])  # two lattices are none
        assert lattice(odd) is None
        digits = np.round(np.random.default_rng(0).standard_normal(90_000), 4)
        assert lattice(digits) is None  # the last ones of a file


def test_what_would_tell_two_explanations_apart_is_said():
    """Friction at the elbow shows most where the elbow moves; two equal fits never differ."""
    nominal = arm()[1]
    narrow = hide(arm()[0], nominal, np.random.default_rng(402), []).episodes(range(8))
    with Simulator(nominal, narrow, threads=1) as simulator:
        plain = fit(simulator, narrow.sensor_variance())
        pushed = [Effect("joint_coulomb_friction", "joint:elbow", (size,)) for size in (0.0, 0.1)]
        one, other, same = (replace(plain, effects=(c,)) for c in (*pushed, pushed[0]))
        found = separating_experiment(one, other)
        equal = separating_experiment(one, same)
    assert "actuator:elbow" in found.description
    assert found.is_worth_it
    assert found.separation > found.recorded > 0
    assert (equal.separation, equal.is_worth_it) == (0, False)


def test_whole_episodes_are_followed_as_step_after_step(good):
    """Open loop, with an effect on commands, one in a sensor and one in the model."""
    causes = [
        Effect("actuator_delay", "actuator:elbow", (0.004,)),
        Effect("sensor_bias", "sensor:elbow.position", (0.02,)),
        Effect("joint_coulomb_friction", "joint:shoulder", (0.2,)),
    ]
    nominal = arm()[1]
    with Simulator(nominal, Measurement(**good), threads=1) as simulator:
        whole = simulator.follow(nominal.start, causes)
        late = [Effect("sensor_delay", "sensor:elbow.position", (0.005,))]
        first_of_late = simulator.follow(nominal.start, late)[1]
        expected = simulator.predict(nominal.start, late, simulator.measured)[0]
        states = simulator.measured.copy()
        for _ in range(3):
            ends = simulator.predict(nominal.start, causes, states)
            states[simulator.starts + 1] = ends
            first = [begin for begin, _ in simulator.data.spans()]
            states[first] = simulator.measured[first]
    np.testing.assert_allclose(first_of_late, expected, rtol=1e-12)
    for begin, _ in simulator.data.spans():
        np.testing.assert_allclose(whole[begin : begin + 4], states[begin : begin + 4], rtol=1e-9)


def test_a_table_is_the_same_measurement_as_its_arrays(good):
    measured = Measurement.from_csv(as_csv(good))
    for name, values in good.items():
        np.testing.assert_array_equal(getattr(measured, name), values)


def as_csv(fields):
    wide = [(n, fields[n]) for n in ("qpos", "qvel", "ctrl")]
    header = ["time", "episode", *(f"{n}_{i}" for n, v in wide for i in range(v.shape[1]))]
    table = np.column_stack([fields["time"], fields["episode"], *(v for _, v in wide)])
    lines = [",".join(map(repr, row)) for row in table.tolist()]
    return "\n".join([",".join(header), *lines])


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("qvel_1", "qvel_7", "expected are time, episode, and from 0 on qpos_0"),
        ("0.0,0.0,", "0.0,first,", "line 2 of the CSV has 'first' for episode"),
        ("0.0,0.0,", "0.0,", "line 2 of the CSV has 7 values; the header has 8"),
        ("0.0,0.0,", "0.0,0.5,", "episodes must be whole numbers"),
        ("0.0,0.0,", "0.0,inf,", "episodes must be whole numbers"),
        ("\n0.0,0.0,", "\n\n\n0.0,first,", "line 4 of the CSV has 'first'"),
    ],
)
def test_a_table_that_is_wrong_is_refused_with_its_line(good, before, after, message):
    with pytest.raises(InvalidInput, match=message):
        Measurement.from_csv(as_csv(good).replace(before, after, 1))


@pytest.mark.parametrize(
    ("name", "spoil", "message"),
    [
        ("qpos", lambda v: 0 * v + 0.5, "qpos, column 1, is 0.5 in all rows"),
        ("qvel", lambda v: np.minimum(v, np.quantile(v, 0.7)), "qvel, column 1, is saturated"),
    ],
)
def test_a_sensor_that_is_stuck_is_named(good, name, spoil, message):
    spoiled = good[name].copy()
    spoiled[:, 1] = spoil(spoiled[:, 1])
    with pytest.raises(InvalidInput, match=message):
        criticise(arm()[1], Measurement(**{**good, name: spoiled}), np.random.default_rng(0))
    # what is not read may be anything
    unread = np.where(np.arange(2) == 1, np.inf, 0.01)
    Measurement(**{**good, name: spoiled, f"{name}_std": unread}).check_usable()


class TestCommandLine:
    """`adr criticise`, from files to files."""

    def run(self, *arguments):
        return CliRunner().invoke(app, ["criticise", *map(str, arguments)])

    def test_a_task_and_a_measurement_give_verdict_report_and_extended_model(self, data, tmp_path):
        done = self.run("--task", "arm", "--data", data, "--out", tmp_path)
        assert done.exit_code == 0, done.output
        verdict = json.loads((tmp_path / "verdict.json").read_text())
        assert verdict["version"] == 1
        assert verdict["verdict"] in ("cause", "tie")
        first = verdict["causes"][0]
        assert first["kind"] in done.output
        assert {"value", "low", "high", "unit"} == set(next(iter(first["parameters"].values())))
        assert mujoco.MjModel.from_xml_path(str(tmp_path / "extended.xml")).nv == 2
        page = (tmp_path / "report.html").read_text()
        assert page.count("<svg") == 5
        assert "The simulator lacks" in page

    def test_a_model_of_ones_own_has_the_parameters_that_were_set_free(self, data, tmp_path):
        model = tmp_path / "arm.xml"
        model.write_text(get_task("arm").xml)
        free = ["--free", "joint:elbow.damping=0:8", "--free", "body:fore.inertial=0.1:5"]
        done = self.run("--model", model, *free, "--data", data, "--out", tmp_path)
        assert done.exit_code == 0, done.output
        moved = json.loads((tmp_path / "verdict.json").read_text())["residual"]["parameters"]
        assert list(moved) == ["joint:elbow.damping", "body:fore.inertial"]

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            ([], "give either --task or --model"),
            (["--task", "arm", "--free", "x=0:1"], "--free goes with --model"),
            (["--model", "nowhere.xml"], "nowhere.xml cannot be read"),
        ],
    )
    def test_what_cannot_be_is_said(self, data, tmp_path, arguments, message):
        done = self.run(*arguments, "--data", data, "--out", tmp_path)
        assert done.exit_code != 0
        assert message in str(done.exception) + done.output
