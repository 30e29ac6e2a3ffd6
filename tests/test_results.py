"""The tables of README.md and results/README.md have the numbers of results.csv."""

import csv
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
VARIANTS = ("vanilla", "noisy", "unmodeled")
METHODS = {
    "the prior's policy": "prior",
    "prior policy": "prior",
    "the oracle's policy": "oracle",
    "oracle": "oracle",
    "UDR": "udr",
    "EPOpt": "epopt",
    "Automatic DR": "auto_dr",
    "DORAEMON": "doraemon",
    "least squares": "sysid",
    "the same with a box": "sysid_wide",
    "the same with a box about its point": "sysid_wide",
    "the same with Laplace's Gaussian": "sysid_laplace",
    "DROPO": "dropo",
    "E-DROPO": "e_dropo",
    "DROID": "droid",
    "SimOpt": "simopt",
    "SimOpt-1": "simopt_1",
    "BayRn": "bayrn",
    "BayesSim": "bayes_sim",
    "NPDR": "npdr",
}
NOT_YET = "-"
WITHOUT_DATA = {"prior", "oracle", "udr", "epopt", "auto_dr", "doraemon"}


@pytest.fixture(scope="module")
def known():
    """Rows of results.csv by method, iteration and variant."""
    with (ROOT / "results/hopper/results.csv").open() as file:
        return {
            (row["method"], int(row["iteration"]), row["variant"]): row
            for row in csv.DictReader(file)
            if (int(row["iteration"]) > 0) != (row["method"] in WITHOUT_DATA)
        }


def in_words(row):
    if not row["low"]:  # of fewer than three seeds
        return f"{float(row['normalised_return']):.2f}"
    numbers = (float(row[name]) for name in ("normalised_return", "low", "high"))
    return "{:.2f} [{:.2f}, {:.2f}]".format(*numbers)


def rows_after(head, page):
    """Labels and cells of the table that begins so."""
    table = (ROOT / page).read_text().split(head)[1].split("\n\n")[0]
    return re.findall(r"^\| (.+?) \| (.+?) \| (.+?) \| (.+?) \|$", table, re.MULTILINE)


def computed(cells):
    """Cells by variant, without those that are not computed yet."""
    named = zip(VARIANTS, cells, strict=True)
    return [(variant, cell) for variant, cell in named if cell != NOT_YET]


def test_the_study_has_every_row_of_every_iteration(known):
    shown = {}
    for label, *cells in rows_after("| | vanilla | noisy | unmodeled |", "results/README.md"):
        name, _, after = label.partition(", ")
        iteration = 0 if after in ("", "no target data") else int(after.split()[0])
        shown |= {(METHODS[name], iteration, v): cell for v, cell in computed(cells)}
    assert shown == {key: f"{in_words(row)}, {row['seeds']}" for key, row in known.items()}


def test_the_readme_has_every_row_of_the_last_iteration(known):
    shown = {}
    head = "| Hopper: target return / threshold after 5 target trajectories | vanilla |"
    for label, *cells in rows_after(head, "README.md"):
        name = METHODS[label.partition(" (")[0].strip("*")]
        iteration = 0 if name in WITHOUT_DATA else 5
        shown |= {(name, iteration, v): cell for v, cell in computed(cells)}
    last = {key: row for key, row in known.items() if key[1] in (0, 5)}
    assert shown == {key: in_words(row) for key, row in last.items()}
