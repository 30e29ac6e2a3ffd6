"""The papers to cite for runs."""

from collections.abc import Iterable

from adr_service.citations import Paper
from adr_service.specs import AnyRun, LostRun, RunSpec

BENCHMARK = Paper(
    "tiboni2022benchmark",
    "Online vs. Offline Adaptive Domain Randomization Benchmark",
    "Tiboni, Gabriele and Arndt, Karol and Averta, Giuseppe and Kyrki, Ville and Tommasi, Tatiana",
    2022,
    arxiv="2206.14661",
)
MUJOCO = Paper(
    "todorov2012mujoco",
    "MuJoCo: A physics engine for model-based control",
    "Todorov, Emanuel and Erez, Tom and Tassa, Yuval",
    2012,
    conference="IEEE/RSJ International Conference on Intelligent Robots and Systems",
)
STABLE_BASELINES3 = Paper(  # whose authors SBX is by, too
    "raffin2021stable",
    "Stable-Baselines3: Reliable Reinforcement Learning Implementations",
    "Raffin, Antonin and Hill, Ashley and Gleave, Adam and Kanervisto, Anssi and "
    "Ernestus, Maximilian and Dormann, Noah",
    2021,
    journal="Journal of Machine Learning Research",
)


def papers_of(specs: Iterable[AnyRun | LostRun]) -> list[Paper]:
    """The papers of the runs, each once: benchmark, methods, training algorithms, software.

    An offline method that learns from SimOpt's trajectories rests on SimOpt's paper as well. Runs
    whose method is not installed any more have no papers here.
    """
    methods, algorithms = list[Paper](), list[Paper]()
    for spec in specs:
        if isinstance(spec, RunSpec):
            asked = [spec.method] if spec.simopt is None else [spec.method, spec.simopt]
            methods += [paper for settings in asked for paper in settings.papers]
            algorithms.append(spec.training.paper)
    known = sorted(dict.fromkeys(methods), key=lambda paper: (paper.year, paper.key))
    run = [BENCHMARK, *known, *dict.fromkeys(algorithms), STABLE_BASELINES3] if algorithms else []
    return [*run, MUJOCO]


def bibtex(papers: Iterable[Paper]) -> str:
    """A BibTeX file."""
    return "\n".join(paper.bibtex() for paper in papers)
