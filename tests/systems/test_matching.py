"""Systems: every name in one means one thing, machine code works out what the function says, and slopes come back."""

from __future__ import annotations

import importlib
import inspect
import math
import pickle
import pkgutil
import re
from collections.abc import Callable, Iterator
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import wtg_gym.physics
import wtg_gym.tasks
from tests.machine_code import run_routine
from wtg_gym.physics import step
from wtg_gym.physics.layout import Layout, place_of
from wtg_gym.physics.machine_models import CONTROLS
from wtg_gym.physics.parameters import ROTOR_TABLE
from wtg_gym.physics.rotor_table import Grid, read_rotor_table, tabulated_power_coefficient
from wtg_gym.physics.units import ControlJoining, Joining
from wtg_gym.systems import expressions as ex
from wtg_gym.systems.elementary import exponential, fma, select, sine_cosine
from wtg_gym.systems.programs import Each, Here, Product, Program, Repeat, When, link, numbered
from wtg_gym.systems.routines import Routine, addresses_of
from wtg_gym.systems.systems import Kind, System, system
from wtg_gym.systems.writers import BackWithoutConstants, TapedWriter
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


def kind(**parts: Any) -> Callable[[], Kind]:
    return lambda: Kind(name="x", **parts)


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
    return lambda: made().trace()


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


ONE = {GUESTS: 1, HOSTS: 1}
REFUSED: dict[str, tuple[Callable[[], Any], str]] = {
    "argument": (named("host_haet"), "'host_haet' of .* guests, nor of what they see: hosts; did you mean 'host_heat'"),
    "argument without its label": (named("far_rating", "ratting"), "'ratting' .* did you mean 'rating'"),
    "written name": (named("state", writes=("copi",)), "writes 'copi', which is no part .* did you mean 'copy'"),
    "own unit and seen unit": (
        named("heat"),
        "argument 'heat' .* can mean 'own_heat' (rows of guests) and 'host_heat' (rows of hosts): use one of these",
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
        "when='awoke' .* is no condition of guests or of what they see: awake, heated; did you mean 'awake'",
    ),
    "state": (kind(rows={"charge": float}, states=("charg",)), "part 'charg' .* mean 'charge'"),
    "two parts of a name": (kind(rows={"a": float}, constants={"a": float}), "two parts .* 'a'"),
    "two states of a name": (kind(rows={"a": float}, states=("a", "a")), "a state twice: a, a"),
    "part of integration": (kind(rows={"a": float}, states=("a",), scratch={"a_base": Pair}), "two parts .* 'a_base'"),
    "part and number": (kind(rows={"a_re": float, "a": Pair}), "a part, and a number within another one, .* 'a_re'"),
    "label": (kind(sees={"own": HOSTS}), "the label 'own' is that of the kind itself"),
    "part written twice": (named("size", writes=("copy", "own_copy")), "writes a number twice: copy, own_copy"),
    "part and number written": (named("size", writes=("copy", "own_copy_re")), "writes a number twice"),
    "flag": (lambda: When(HOSTS, "hot", ()), "'hot' is no part or constant of hosts, nor of what they see: nothing"),
    "flag of several numbers": (lambda: Repeat(HOSTS, "flow", (), most=2), "'flow' of hosts is no single number"),
    "matrix": (lambda: Product(HOSTS, "flaw", GUESTS, "copy", "copy"), "hosts have no part 'flaw' .* mean 'flow'"),
    "vector in rows": (lambda: Product(HOSTS, "flow", GUESTS, "state", "copy"), "no part 'state' in scratch"),
    "real vector": (lambda: Product(HOSTS, "flow", GUESTS, "level", "copy"), "must be complex numbers"),
    "link": (
        lambda: Layout(ONE, {(GUESTS, "hots"): np.array([0])}),
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
    run_routine(Routine(program), arrays, link((program,), layout))
    return arrays[0].ravel().tolist(), arrays[1].ravel().tolist()


def test_full_names_say_which():
    block = [*(1.0, 2.0), 30.0, *(0.0,) * 3, 4.0, *(5.0, 6.0)]
    _, scratch = ran(function(of_two, "own_level")(), PlantMap(ONE, {}), block)
    assert scratch[-2:] == [26.0, 0.0]
    of_record = named("own_state_im", writes=("host_level",))()
    assert ran(of_record, PlantMap(ONE, {}), block)[1][-2:] == [0.0, 2.0]


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
            unknown = name in ("control", "model") and one.equation.__module__ == "wtg_gym.physics.control_blocks"
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

    result = places((*(each for each in vars(step).values() if isinstance(each, tuple)), V0.charge, V1.observe))
    assert set(result) == {*Joining, *ControlJoining}


N_UNITS = 3
ROTORS = Kind(
    name="rotors",
    rows={"ratio": float, "pitch_deg": float},
    scratch={"coefficient": float},
    constants={"cells": ex.Cells, "grid": Grid},
)
ORDINARY = st.floats(-1e100, 1e100, allow_subnormal=False)
SUMS = Kind(name="sums", rows={"a": float, "b": float, "c": float, "sum": float})
(PROGRAM,) = numbered(SUM=(system(SUMS, "sum")(lambda a, b, c: fma(a, b, c)),))
ROUTINE, CODE = Routine(PROGRAM), link((PROGRAM,), Layout({SUMS: 1}, {}))


FUNCTIONS = {
    "sum": lambda a, b: a + 2.0 * b - 3.0 + (1.0 - a),
    "product": lambda a, b: a * b * 0.5,
    "quotient": lambda a, b: a / b + 2.0 / a,
    "power": lambda a, b: 4.0**-a + 1.0 * b,
    "size": lambda a, b: abs(a) - abs(-b),
    "bounds": lambda a, b: min(a, b) * 3.0 + max(a, 0.5) + max(-1.0, b),
    "root": lambda a, b: math.sqrt(a * a + b * b),
    "waves": lambda a, b: sine_cosine(a)[0] * sine_cosine(b)[1],
    "exponential": lambda a, b: exponential(-a * b) + exponential(b - 50.0),
    "choice": lambda a, b: select((a > b) | (b >= 2.0), a * a, b) + select((a < b) & (a <= 9.0), b, 0.0),
    "multiply_add": lambda a, b: fma(a, b, a) + fma(0.0, b, a),
    "steps": lambda a, b: math.floor(a) * b + math.ceil(b) * a,
    # Of the branch not taken nothing may come back, not even 0/0 or the slope of a root at zero.
    "guarded": lambda a, b: select(b > -9.0, a * b, b / (a - a)) + select(a > b, 1.0, math.sqrt(a - a)),
}
UNITS = Kind(name="units", rows={"a": float, "b": float}, scratch={name: float for name in FUNCTIONS})
SYSTEMS = tuple(system(UNITS, name)(function) for name, function in FUNCTIONS.items())
FORWARD, BOTH_WAYS = numbered(FORWARD=SYSTEMS, BOTH_WAYS=SYSTEMS)
POINTS = [(0.3, 0.8), (1.7, 0.4), (0.9, -1.3), (-0.6, 2.5)]


class PlantMap(Layout):
    """Units without constants, or with a table."""

    conditions = ()

    @property
    def constants(self):
        grid, cells = read_rotor_table(ROTOR_TABLE).surface()
        return {(ROTORS, "cells"): cells, (ROTORS, "grid"): [grid] * self.n_units(ROTORS)}


@pytest.mark.parametrize("width", [1, 16])
def test_every_unit_of_every_env_has_what_the_function_says(width):
    layout = PlantMap({UNITS: N_UNITS}, {})
    code = link((FORWARD, BOTH_WAYS), layout)
    rng = np.random.default_rng(0)
    block, scratch = rng.uniform(-2.0, 3.0, (layout.n_rows, width)), np.zeros((layout.n_scratch, width))
    run_routine(Routine(FORWARD), (block, scratch), code)
    for name, function in FUNCTIONS.items():
        rows = scratch[layout.first_rows(UNITS, name)]
        with np.errstate(all="ignore"):
            for (j, x), value in np.ndenumerate(rows):
                a, b = (np.float64(block[layout.first_rows(UNITS, part)[j], x]) for part in "ab")
                assert value == (np.nan_to_num(a * b) + (a > b) if name == "guarded" else function(a, b)), name


@pytest.mark.parametrize("point", POINTS)
def test_what_comes_back_are_the_slopes(point):
    layout, h = PlantMap({UNITS: 1}, {}), 1e-6
    code = link((FORWARD, BOTH_WAYS), layout, (BOTH_WAYS,))
    tape, scratch = np.zeros((BOTH_WAYS.tape_rows(layout), 16)), np.zeros((layout.n_scratch, 16))
    run_routine(Routine(BOTH_WAYS, TapedWriter), (np.repeat([point], 16, axis=0).T.copy(), scratch, tape), code)
    for name, function in FUNCTIONS.items():
        bars, given = np.zeros((2, 16)), np.zeros((layout.n_scratch, 16))
        given[layout.first_rows(UNITS, name)] = 2.0
        run_routine(Routine(BOTH_WAYS, BackWithoutConstants), (bars, given, tape, scratch, bars), code)
        # What was written is gone with what it replaced.
        assert not given.any()
        (a, b) = point
        if name == "guarded":
            function = FUNCTIONS["product"]
            expected = [4.0 * (function(a + h, b) - function(a - h, b)) / (2.0 * h), 2.0 * a]
        else:
            expected = [(function(a + h, b) - function(a - h, b)) / h, (function(a, b + h) - function(a, b - h)) / h]
        assert bars[:, 0].tolist() == pytest.approx(expected, rel=1e-8, abs=1e-8), name


@system(ROTORS, "coefficient")
def coefficient_of(ratio: float, pitch_deg: float, cells: ex.Cells, grid: Grid) -> float:
    return tabulated_power_coefficient(ratio, pitch_deg, cells, grid)


#: Tip-speed ratio and pitch angle [deg] within the table, below its first ratio, and beyond its last one.
@pytest.mark.parametrize(("ratio", "pitch_deg"), [(7.3, 0.2), (5.1, 11.7), (1.2, 3.0), (40.0, 4.4)])
def test_a_table_is_looked_up_and_has_the_slopes_of_its_surface(ratio, pitch_deg):
    (program,) = numbered(TABLE=(coefficient_of,))
    layout = PlantMap({ROTORS: 1}, {})
    code = link((program,), layout, (program,))
    block, scratch, tape = np.array([[ratio], [pitch_deg]]), np.zeros((1, 1)), np.zeros((program.tape_rows(layout), 1))
    run_routine(Routine(program, TapedWriter), (block, scratch, tape), code)
    bars, value = np.zeros((2, 1)), scratch[0, 0]
    run_routine(Routine(program, BackWithoutConstants), (bars, np.ones((1, 1)), tape, scratch, bars), code)
    grid, cells = read_rotor_table(ROTOR_TABLE).surface()
    h, function = 1e-6, tabulated_power_coefficient
    ends = [function(ratio + h * a, pitch_deg + h * b, cells, grid) for a, b in ((1, 0), (-1, 0), (0, 1), (0, -1))]
    assert value == function(ratio, pitch_deg, cells, grid)
    expected = [(ends[0] - ends[1]) / (2 * h), (ends[2] - ends[3]) / (2 * h)]
    assert bars[:, 0] == pytest.approx(expected, rel=1e-7, abs=1e-9)


def test_programs_that_differ_in_one_thing_have_machine_code_of_their_own():
    in_rows = Kind(name="places", rows={"x": float, "y": float, "flag": float})
    in_scratch = Kind(name="places", rows={"x": float}, scratch={"y": float, "flag": float})
    digests = []
    for kind in (in_rows, in_scratch):
        first, second = system(kind, "y")(lambda x: x + 1.0), system(kind, "x")(lambda y: 2.0 * y)
        lists = [
            (first, second),
            (Each(first, second),),
            (When(kind, "flag", (first,)), second),
            (When(kind, "flag", (first, second)),),
            *((Repeat(kind, "flag", (first, second), most=most),) for most in (2, 3)),
        ]
        digests += [Program("same", entries, 0).digest() for entries in lists]
    assert len(set(digests)) == len(digests) == 12


def test_branches_on_traced_numbers_are_refused_and_addresses_stay_in_their_process():
    with pytest.raises(TypeError, match="select"):
        bool(ex.symbol("a") > 1.0)
    code = link((FORWARD, BOTH_WAYS), PlantMap({UNITS: 1}, {}))
    linked = code._replace(addresses=addresses_of((FORWARD, BOTH_WAYS), {16: (Routine(FORWARD),)}, {}))
    assert linked.addresses.any()
    # They mean nothing in another one.
    assert pickle.loads(pickle.dumps(linked)).addresses.size == 0


def exact_multiply_add(a: float, b: float, c: float) -> float:
    try:
        total = Fraction(a) * Fraction(b) + Fraction(c)
        # A sum of nothing keeps the sign that floating-point zeros give it.
        return float(total) if total else a * b + c
    except (OverflowError, ValueError):  # too large, or infinite or NaN to begin with
        return c if math.isinf(c) and math.isfinite(a) and math.isfinite(b) else a * b + c


@given(ORDINARY, ORDINARY, ORDINARY)
@example(-0.0, 1.0, -0.0)
@example(math.inf, 1.0, 0.0)
@example(math.nan, 1.0, 0.0)
@example(1e300, 1e300, 0.0)
@example(-1e300, 1e300, 1.0)
@example(1.0 + 2.0**-30, 1.0 + 2.0**-30, -1.0 - 2.0**-29)
def test_compiled_multiply_add_has_the_bits_of_the_exact_one(a, b, c):
    block = np.array([[a], [b], [c], [0.0]])
    run_routine(ROUTINE, (block, np.zeros((0, 1))), CODE)
    assert repr(float(block[3, 0])) == repr(fma(a, b, c)) == repr(exact_multiply_add(a, b, c))


@given(st.floats(-1e4, 1e4), st.floats(-39.9, 0.0))
def test_sine_cosine_and_exponential_agree_with_libm_and_are_exact_at_zero(angle, exponent):
    assert sine_cosine(0.0) == (0.0, 1.0) and exponential(0.0) == 1.0
    assert sine_cosine(angle) == pytest.approx((math.sin(angle), math.cos(angle)), abs=4e-15, rel=0.0)
    assert exponential(exponent) == pytest.approx(math.exp(exponent), rel=3e-14, abs=0.0)
