"""The catalogue of methods, and what installed packages add to it."""

import pytest
from pydantic import TypeAdapter, ValidationError

from adr_service.errors import InvalidInput
from adr_service.methods.catalogue import (
    AnyMethod,
    check_installed,
    method_inputs,
    methods,
    name_of,
    names_of,
)
from adr_service.methods.simopt import SimOpt1Settings, SimOptSettings
from tests.packages import python


def test_the_catalogue_has_the_methods_of_the_benchmark_in_order():
    ours = ["udr", "bayrn", "simopt", "simopt_1", "droid", "dropo", "sysid", "prior", "oracle"]
    assert [name for name in methods() if name in ours] == ours


def test_names_by_data_are_those_of_the_settings():
    assert set(names_of("recordings")) >= {"droid", "dropo", "sysid"}
    assert names_of("returns") == ["bayrn"]
    for name in names_of("visits"):
        assert methods()[name].learns_from == "visits"


@pytest.mark.parametrize("name", ["droid", "dropo", "sysid"])
def test_an_offline_method_on_smoothed_states_has_the_settings_of_its_own(name):
    papers, extension = methods()[name], methods()[f"{name}_smoothed"]
    assert (papers.replay_from, extension.replay_from) == ("recorded", "smoothed")
    assert papers().model_dump(exclude={"name"}) == extension().model_dump(exclude={"name"})
    assert (papers.label or name) in extension.label


def test_a_name_is_the_only_value_of_the_literal():
    assert name_of(SimOpt1Settings) == "simopt_1"


def test_a_base_class_of_settings_has_no_name():
    assert name_of(SimOpt1Settings.__mro__[1]) == ""


def test_settings_are_read_by_their_name():
    read = TypeAdapter(AnyMethod).validate_python({"name": "simopt", "updates": 3})
    assert read == SimOptSettings(updates=3)


def test_an_unknown_method_is_refused_with_a_list():
    with pytest.raises(ValidationError, match="'simopt'"):
        TypeAdapter(AnyMethod).validate_python({"name": "magic"})


def test_stages_know_our_methods_by_their_settings_alone():
    assert method_inputs(SimOptSettings()) == {"method": SimOptSettings(), "method_package": None}


ADD = """
import adr_service.methods
adr_service.methods.__path__.append({folder!r})
from adr_service.methods.catalogue import methods
print([name for name in methods() if name not in ("prior", "oracle")])
"""
ANOTHER = """
from typing import ClassVar, Literal
from adr_service.methods.base import Data, MethodSettings

class BaseSettings(MethodSettings):
    name: str

class AnotherSettings(MethodSettings):
    name: Literal["another"] = "another"
    program: ClassVar[str] = "adr_service.programs.udr"
    learns_from: ClassVar[Data] = "nothing"
"""


def test_a_file_in_the_package_is_in_the_catalogue_and_its_base_class_is_not(tmp_path):
    (tmp_path / "another.py").write_text(ANOTHER)
    done = python(ADD.format(folder=str(tmp_path)))
    assert done.returncode == 0, done.stderr
    ours = ["auto_dr", "doraemon", "epopt", "udr", "fixed_dr", "another"]
    ours += ["bayrn", "simopt", "simopt_1", "simopt_memory"]
    ours += ["bayes_sim", "droid", "droid_smoothed", "dropo", "dropo_smoothed", "e_dropo", "npdr"]
    ours += ["sysid", "sysid_smoothed", "sysid_wide", "sysid_laplace"]
    assert done.stdout.strip() == str(ours)


def test_a_method_without_its_extra_is_refused_with_what_to_install(monkeypatch):
    monkeypatch.setattr("adr_service.methods.catalogue.find_spec", lambda name: None)
    check_installed("dropo")
    with pytest.raises(InvalidInput, match=r"npdr needs sbi: pip install 'adr-service\[sbi\]'"):
        check_installed("npdr")
