"""Matching: every name in a system means one thing, and a misspelt one is refused with the nearest name."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
import pytest

import wtg_gym.physics
import wtg_gym.tasks
from tests.systems.test_systems import PlantMap
from wtg_gym.physics import step
from wtg_gym.physics.layout import Layout, place_of
from wtg_gym.physics.machine_models import CONTROLS
from wtg_gym.physics.units import ControlJoining, Joining
from wtg_gym.systems.programs import Here, Product, Program, Repeat, When, build_table
from wtg_gym.systems.routines import Routine
from wtg_gym.systems.systems import Kind, System, system
from wtg_gym.tasks import V0, V1


class Pair(NamedTuple):
    re: float
    im: float


class Other(NamedTuple):
    """As many numbers, of another meaning."""

    re: float
    im: float


HOSTS = Kind(
    name="hosts",
    rows={"heat": float, "flow": Pair},
    scratch={"level": float},
    constants={"rating": float},
    conditions=("heated",),
)
GUESTS = Kind(
    name="guests",
    rows={"state": Pair, "heat": float, "first": float, "other": Other},
    scratch={"copy": Pair, "level": float},
    constants={"size": Pair},
    sees={"host": HOSTS, "far_": HOSTS},
    states=("state",),
    conditions=("awake",),
)


def named(*arguments: str, writes: tuple[str, ...] = ("copy",), **more: Any) -> Callable[[], System]:
    return lambda: System(GUESTS, lambda *values: values[0], writes, arguments=arguments, **more)


def function(equation: Callable[..., Any], *writes: str, **more: Any) -> Callable[[], System]:
    return lambda: system(GUESTS, *writes, **more)(equation)


def float_for_record(state: float) -> float:
    return state


def record_for_float(own_heat: Pair) -> Pair:
    return own_heat


def of_two(own_heat: float, host_heat: float) -> float:
    return own_heat - host_heat


def of_two_the_other_way_round(host_heat: float, own_heat: float) -> float:
    return own_heat - host_heat


def other_back(other: Other) -> Other:
    return other


def traced(made: Callable[[], System]) -> Callable[[], Any]:
    return lambda: made().trace


def other_of_the_same_name() -> System:
    class Pair(NamedTuple):
        im: float
        re: float

    def system_of_pair(state: Pair) -> Any:
        return Pair(state.re, state.im)

    return System(GUESTS, system_of_pair, ("copy",))


def unknown_annotation() -> System:
    def system_of_none(state: Unheard) -> Any:  # noqa: F821
        return state

    return System(GUESTS, system_of_none, ("copy",))


REFUSED: dict[str, tuple[Callable[[], Any], str]] = {
    "argument": (
        named("host_haet"),
        "argument 'host_haet' of system '<lambda>' is no part or constant of guests, nor of what they see: "
        "hosts; did you mean 'host_heat'",
    ),
    "argument without its label": (named("far_rating", "ratting"), "'ratting' .* did you mean 'rating'"),
    "written name": (named("state", writes=("copi",)), "writes 'copi', which is no part .* did you mean 'copy'"),
    "own unit and seen unit": (
        named("heat"),
        "argument 'heat' of system '<lambda>' can mean 'own_heat' (rows of guests) and 'host_heat' (rows of hosts): "
        "use one of these full names",
    ),
    "numbers of two records": (named("im"), "'own_state_im' (rows of guests) and 'own_other_im' (rows of guests)"),
    "part and scalar": (named("first"), "can mean 'first' (scalars of guests) and 'own_first' (rows of guests)"),
    "written name of two": (named("state", writes=("level",)), "'own_level' (scratch of guests) and 'host_level'"),
    "written constant": (named("size", writes=("size",)), "writes 'size', which is one of the constants"),
    "float for a record": (function(float_for_record, "copy"), "'state' .* means .*Pair, but is annotated with float"),
    "record for a float": (function(record_for_float, "copy"), "'own_heat' .* means float, but is annotated with"),
    "another record of its name": (other_of_the_same_name, "'state' .* means .*Pair, but is annotated with .*Pair"),
    "unknown annotation": (unknown_annotation, "an annotation of system 'system_of_none' is unknown: .*Unheard"),
    "result of another record": (traced(function(other_back, "copy")), "writes .*Other to 'copy', which is .*Pair"),
    "too few results": (traced(function(other_back, "other", "copy")), "writes other, copy, but returns 1 values"),
    "way back": (
        function(of_two, "own_level", backward=of_two_the_other_way_round),
        "the way back of system 'of_two' takes ('host_heat', 'own_heat'), not ('own_heat', 'host_heat')",
    ),
    "condition": (
        named("state", when="awoke"),
        "when='awoke' of system '<lambda>' is no condition of guests or of what they see: awake, heated; did you mean "
        "'awake'",
    ),
    "state": (lambda: Kind(name="x", rows={"charge": float}, states=("charg",)), "part 'charg' .* mean 'charge'"),
    "two parts of a name": (lambda: Kind(name="x", rows={"a": float}, constants={"a": float}), "two parts .* 'a'"),
    "two states of a name": (lambda: Kind(name="x", rows={"a": float}, states=("a", "a")), "a state twice: a, a"),
    "part of the integration": (
        lambda: Kind(name="x", rows={"a": float}, states=("a",), scratch={"a_base": Pair}),
        "two parts with the name 'a_base'",
    ),
    "part and number": (
        lambda: Kind(name="x", rows={"a_re": float, "a": Pair}),
        "a part, and a number within another one, with the name 'a_re'",
    ),
    "label": (lambda: Kind(name="x", sees={"own": HOSTS}), "the label 'own' is that of the kind itself"),
    "part written twice": (named("size", writes=("copy", "own_copy")), "writes a number twice: copy, own_copy"),
    "part and number written": (named("size", writes=("copy", "own_copy_re")), "writes a number twice"),
    "flag": (lambda: When(HOSTS, "hot", ()), "'hot' is no part or constant of hosts, nor of what they see: nothing"),
    "flag of several numbers": (lambda: Repeat(HOSTS, "flow", (), most=2), "'flow' of hosts is no single number"),
    "matrix": (lambda: Product(HOSTS, "flaw", GUESTS, "copy", "copy"), "hosts have no part 'flaw' .* mean 'flow'"),
    "vector in rows": (lambda: Product(HOSTS, "flow", GUESTS, "state", "copy"), "no part 'state' in scratch"),
    "real vector": (lambda: Product(HOSTS, "flow", GUESTS, "level", "copy"), "must be complex numbers"),
    "link": (
        lambda: Layout({GUESTS: 1, HOSTS: 1}, {(GUESTS, "hots"): np.array([0])}),
        "unknown labels of what guests see ['hots']; known labels of what guests see: host, far_; did you mean 'host'",
    ),
    "row by a name of two": (lambda: place_of(GUESTS, "re"), "2 numbers of guests have the name 're'"),
}


@pytest.mark.parametrize(("make", "sentence"), REFUSED.values(), ids=REFUSED)
def test_what_has_no_meaning_or_several_is_refused(make, sentence):
    pattern = re.escape(sentence).replace(r"\.\*", ".*")
    with pytest.raises((TypeError, ValueError, KeyError), match=pattern):
        make()


def ran(one: System, layout: Layout, block: list[float]) -> tuple[list[float], list[float]]:
    program = Program("RUN", (one,), 0)
    arrays = np.array([block]).T.copy(), np.zeros((layout.n_scratch, 1))
    Routine(program)(arrays, build_table((program,), layout))
    return arrays[0].ravel().tolist(), arrays[1].ravel().tolist()


def test_full_names_say_which():
    block = [*(1.0, 2.0), 30.0, *(0.0,) * 3, 4.0, *(5.0, 6.0)]
    _, scratch = ran(function(of_two, "own_level")(), PlantMap({GUESTS: 1, HOSTS: 1}, {}), block)
    assert scratch[-2:] == [26.0, 0.0]
    of_record = named("own_state_im", writes=("host_level",))()
    assert ran(of_record, PlantMap({GUESTS: 1, HOSTS: 1}, {}), block)[1][-2:] == [0.0, 2.0]


def test_a_number_that_is_written_by_another_name_than_it_is_read_by_is_read_first():
    pairs = Kind(name="pairs of numbers", rows={"pair": Pair, "sum": float})

    @system(pairs, "re", "sum")
    def clear(pair: Pair) -> tuple[float, float]:
        return 0.0, pair.re + pair.im

    assert ran(clear, PlantMap({pairs: 1}, {}), [5.0, 7.0, 0.0])[0] == [0.0, 7.0, 12.0]


def shipped() -> Iterator[System]:
    for room in (wtg_gym.physics, wtg_gym.tasks):
        for file in pkgutil.iter_modules(room.__path__, f"{room.__name__}."):
            yield from (each for each in vars(importlib.import_module(file.name)).values() if isinstance(each, System))
    for control in CONTROLS.values():
        yield from (each for systems in control.systems.values() for each in systems)


def test_every_name_of_every_system_means_one_thing_and_is_annotated_with_it():
    systems = {id(one): one for one in shipped()}.values()
    for one in systems:
        assert all(len(one.kind.meanings(name)) == 1 for name in (*one.arguments_named, *one.writes)), one.name
        if one.arguments:
            continue
        annotations = inspect.get_annotations(one.equation, eval_str=True)
        for name in one.arguments_named:
            # The records of controls are made when they are.
            unknown = name in ("control", "model") and one.equation.__module__ == "wtg_gym.physics.machine_controls"
            assert annotations[name] is (Any if unknown else one.places[name].record), (one.name, name)
    assert len(systems) > 140


def test_there_is_a_list_for_every_place_where_systems_may_join():
    def places(entry: Any) -> Iterator[str]:
        if isinstance(entry, Here):
            yield entry.name
        elif isinstance(entry, tuple):
            for each in entry:
                yield from places(each)
        elif isinstance(entry, (When, Repeat)):
            yield from places(entry.entries)

    found = places((*(each for each in vars(step).values() if isinstance(each, tuple)), V0.charge, V1.observe))
    assert set(found) == {*Joining, *ControlJoining}
