"""`verdict.json`, version 1: users' scripts read it."""

import json

import numpy as np

from adr_service.criticism.verdict import (
    Conclusion,
    Experiment,
    Gain,
    NamedCause,
    Residual,
    Rest,
    StrengthInterval,
    Trace,
    Verdict,
)

EXPECTED = {
    "version": 1,
    "verdict": "tie",
    "confidence": 0.9,
    "causes": [
        {
            "kind": "wind",
            "location": "global",
            "parameters": {
                "density": {"value": 1.2, "low": 1.0, "high": 1.4, "unit": "kg/m³"},
                "speed x": {"value": 2.0, "low": None, "high": None, "unit": "m/s"},
            },
            "confidence": 0.7,
            "gain_nats": 55.0,
        }
    ],
    "tied": [
        [
            {
                "kind": "fluid_drag",
                "location": "global",
                "parameters": {"density": {"value": 1.3, "low": 1.1, "high": 1.5, "unit": "kg/m³"}},
                "confidence": 0.2,
                "gain_nats": 54.0,
            }
        ]
    ],
    "experiments": [
        [{"description": "push", "separation": 5.0, "recorded": 1.0, "is_worth_it": True}]
    ],
    "residual": {
        "sensor_noise": [0.001, 0.01],
        "timestep": {"judged_with": 0.001, "of_the_model": 0.002},
        "unexplained_nats": 30.0,
        "rest": "unknown",
        "where": {"location": "joint:knee", "depends_on": "time", "hertz": None},
        "parameters": {"mass": {"without": 1.0, "with": 1.1, "at_bound": True}},
        "transitions": {"used": 200, "diverged": 2},
        "detectable": {"wind global": {"value": 0.1, "unit": "kg/m³"}},
        "confused": [["body_mass body:fore", "payload body:fore"]],
    },
    "gain": {
        "sse_removed": 0.5,
        "low": 0.4,
        "high": 0.6,
        "explainable_fraction": 0.8,
        "explainable_interval": [0.6, 0.9],
        "diverged": {"without": 1, "with": 0},
        "error_by_horizon": {"1": {"without": 1.5, "with": 1.0}},
    },
    "remarks": ["short episodes"],
    "seconds": 12.5,
}


def test_every_field_of_a_verdict_keeps_its_name_and_place():
    density = StrengthInterval("density", 1.2, 1.0, 1.4, "kg/m³")
    speed = StrengthInterval("speed x", 2.0, -np.inf, np.inf, "m/s")
    wind = NamedCause("wind", "global", (density, speed), confidence=0.7, gain=55.0)
    drag = NamedCause(
        "fluid_drag", "global", (StrengthInterval("density", 1.3, 1.1, 1.5, "kg/m³"),), 0.2, 54.0
    )
    residual = Residual(
        noise=(0.001, 0.01),
        step=0.001,
        own_step=0.002,
        unexplained_nats=30.0,
        rest="unknown",
        where=Rest("joint:knee", "time", None),
        moved={"mass": (1.0, 1.1)},
        at_bound=("mass",),
        used=200,
        diverged=2,
        detectable={"wind global": (0.1, "kg/m³")},
        confused=(("body_mass body:fore", "payload body:fore"),),
    )
    nothing = np.zeros((1, 2))
    gain = Gain(
        sse_removed=0.5,
        low=0.4,
        high=0.6,
        explainable_fraction=0.8,
        explainable_interval=(0.6, 0.9),
        horizons={1: (1.5, 1.0)},
        diverged=(1, 0),
        trace=Trace(np.zeros(1), nothing, nothing, nothing),
    )
    verdict = Verdict(
        conclusion=Conclusion.TIE,
        confidence=0.9,
        causes=(wind,),
        tied=((drag,),),
        experiments=((Experiment("push", separation=5.0, recorded=1.0),),),
        residual=residual,
        gain=gain,
        remarks=("short episodes",),
        seconds=12.5,
    )
    assert verdict.to_json() == EXPECTED
    assert list(verdict.to_json()) == list(EXPECTED)
    json.dumps(verdict.to_json(), allow_nan=False)
