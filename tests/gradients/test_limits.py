"""What is traced of the kernels, and gradients through the limits of the converters and a table of coefficients."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from tests.gradients.test_gradients import N_LANES, V1, actions_of, agrees, drawn, given, tape_of
from wtg_gym.envs.task import step_blocks
from wtg_gym.gradients import expressions as ex
from wtg_gym.gradients import kernel_programs
from wtg_gym.gradients.adjoint import build_pull_limits
from wtg_gym.gradients.kernel_programs import programs_of, require_known
from wtg_gym.gradients.tape import Tape
from wtg_gym.physics.elementary import exponential, fma, select, sine_cosine
from wtg_gym.physics.ieee14 import modified_ieee14
from wtg_gym.physics.machine_parameters import HydroGovernorParameters
from wtg_gym.physics.plant import PlantSettings, build_plant
from wtg_gym.physics.scenario import GroupTrip, LoadStep

Floats = npt.NDArray[np.float64]
#: A group trips in strong wind, and others take over until load is lost too: their currents are limited meanwhile.
OVERLOAD = (GroupTrip(time_s=1.0, group=0), LoadStep(time_s=1.6, bus=4, power_mw=-70.0))


def limited_tape() -> tuple[Tape, Floats]:
    """Return a tape that stands where currents of its lanes are limited, and the values of its rows."""
    tape = tape_of(**V1)
    tape.start([given(4, *OVERLOAD, wind=11.5)] * N_LANES)
    for own in actions_of(tape, 60, 0.2):
        tape.step(own)
        if (reactances(tape) > 0.0).any(axis=1).all():
            return tape, tape._values()[0].copy()
    raise AssertionError("no current was limited")


def reactances(tape: Tape) -> Floats:
    return tape.lanes.simulator.wtg_values("limiting_reactance")


def compiled_by_python(source: str) -> Any:
    space: dict[str, Any] = {"chosen": select, "fma": fma, "sine_cosine": sine_cosine, "exponential": exponential}
    exec(source, {**space, "math": math, "inf": math.inf}, space)
    return space["traced"]


def test_the_traced_right_hand_side_is_that_of_the_kernel() -> None:
    lanes = tape_of().lanes
    lanes.start(range(N_LANES), drawn(tape_of()))
    simulator = lanes.simulator
    rng = np.random.default_rng(0)
    for _ in range(30):
        lanes.step(rng.uniform(-1.0, 1.0, (N_LANES, lanes.n_action)))
    program = programs_of(simulator.plant, lanes.task, simulator.layout.n_rows, lanes.n_action).rates
    block = tape_of()._values()[0][:, 0].copy()
    compiled_by_python(ex.function_source("traced", ("fraction",), program))(block, 0.0, (0,))
    simulator.evaluate()
    rates = simulator.rates()
    assert np.abs(rates).max() > 1e-3
    assert block[simulator.layout.rate_rows] == pytest.approx(rates, rel=1e-12, abs=1e-12)


def test_the_traced_right_hand_side_is_that_of_the_kernel_while_currents_are_limited() -> None:
    tape, rows = limited_tape()
    lanes, simulator, steps = tape.lanes, tape.lanes.simulator, tape._rules.steps
    programs = programs_of(simulator.plant, lanes.task, simulator.layout.n_rows, lanes.n_action)
    network, sweep, rates = (
        compiled_by_python(ex.function_source("traced", arguments, program))
        for arguments, program in (((), programs.network), ((), programs.sweep), (("fraction",), programs.rates))
    )
    simulator.evaluate()
    for lane in range(N_LANES):
        block = rows[:, lane].copy()
        network(block, (0,))
        block[steps.sources] = block[steps.limited[: steps.sources.size]]
        for _ in range(200):
            sweep(block, (0,))
        rates(block, 0.0, (0,))
        found = simulator.rates(lane)
        assert np.abs(found).max() > 1e-3
        assert block[simulator.layout.rate_rows] == pytest.approx(found, rel=1e-12, abs=1e-12)


def test_the_way_back_through_the_limits_is_the_adjoint_of_their_fixed_point() -> None:
    """By another road: one system of linear equations for all groups, with the derivatives of the complex step."""
    tape, _ = limited_tape()
    simulator, steps, rules = tape.lanes.simulator, tape._rules.steps, tape._rules
    c, layout, width = simulator.plant.constants[0], simulator.layout, simulator.width
    n, m, n_limited = layout.n_unit, layout.n_wtg, steps.limited.size
    simulator.evaluate()
    work = np.zeros((2 * rules.n_rows, width))
    work[: layout.n_rows] = tape._values()[0]
    given_back = np.random.default_rng(0).normal(size=(n_limited, width))
    work[rules.n_rows + steps.limited] = given_back
    before = work.copy()
    flat = work.ravel()
    build_pull_limits(rules)(flat, steps, simulator.lanes)
    found = flat.reshape(work.shape)[rules.n_rows + steps.limited]
    largest = c["extension"][0]["limits.current_max"] * c["share"]
    for lane in range(N_LANES):
        value = before[:, lane]
        admittance = value[layout.rows.admittance :][: 2 * n * n].reshape(n, n, 2) @ [1.0, 1.0j]
        real = np.block([[admittance.real, -admittance.imag], [admittance.imag, admittance.real]])
        own = np.r_[n - m : n, 2 * n - m : 2 * n]
        # ΔE of every group follows its own free current: that with all others as they are.
        moved = (value[steps.limited[: 2 * m]] - value[steps.sources]).reshape(m, 2).T.ravel()
        current = value[steps.limited[2 * m :]].reshape(n, 2).T.ravel()
        diagonal = np.diag(admittance)[n - m :]
        others = real[np.ix_(own, own)].copy()
        own_part = np.block(
            [[np.diag(diagonal.real), -np.diag(diagonal.imag)], [np.diag(diagonal.imag), np.diag(diagonal.real)]]
        )
        others -= own_part
        free = current[own] - own_part @ moved
        follows = np.zeros((2 * m, 2 * m))
        for j in range(m):
            for part in range(2):
                step = np.array([free[j], free[m + j]], dtype=complex)
                step[part] += 1e-30j
                follows[[j, m + j], j + part * m] = drop(*step, diagonal[j], largest[j]).imag / 1e-30
        assert follows.any()
        voltages = given_back[: 2 * m, lane].reshape(m, 2).T.ravel()
        currents = given_back[2 * m :, lane].reshape(n, 2).T.ravel()
        # λ = Ē + Yᵀ Ī + (∂ΔE others)ᵀ λ
        cause = np.linalg.solve(np.eye(2 * m) - others.T @ follows.T, voltages + real[:, own].T @ currents)
        expected = currents.copy()
        expected[own] += follows.T @ cause
        size = np.abs(expected).max()
        assert found[2 * m :, lane].reshape(n, 2).T.ravel() == pytest.approx(expected, abs=1e-12 * size)
        # The voltages before the limits act come through as they are.
        assert found[: 2 * m, lane].reshape(m, 2).T.ravel() == pytest.approx(voltages, abs=1e-12 * size)
    # A lane without a limited current keeps its bits.
    assert np.array_equal(found[:, N_LANES:], given_back[:, N_LANES:])


def drop(re: complex, im: complex, y: complex, largest: float) -> npt.NDArray[np.complex128]:
    """Return -jX_v I of a group with a free current, as (real part, imaginary part), for the complex step."""
    if abs(complex(re.real, im.real)) <= largest:
        return np.zeros(2, dtype=complex)
    z = 1.0 / y
    reactance = np.sqrt((re * re + im * im) * abs(z) ** 2 / largest**2 - z.real**2) - z.imag
    # I = I_0 / (1 + jX_v Y), in parts.
    d_re, d_im = 1.0 - reactance * y.imag, reactance * y.real
    size = d_re * d_re + d_im * d_im
    current_re, current_im = (re * d_re + im * d_im) / size, (im * d_re - re * d_im) / size
    return np.array([reactance * current_im, -reactance * current_re])


def test_the_gradient_goes_through_the_limits_of_currents_and_powers() -> None:
    tape = tape_of(**V1)
    step = LoadStep(time_s=1.0, bus=2, power_mw=60.0, reactive_mvar=60.0)
    scenarios = [given(4, *OVERLOAD, wind=11.5), given(4, step, wind=11.5), given(4, *OVERLOAD, wind=11.5)]
    actions = actions_of(tape, 80, 0.2)
    agrees(tape, scenarios, actions)
    tape.start(scenarios)
    limited, over_power = np.zeros(N_LANES, dtype=int), np.zeros(N_LANES)
    for own in actions:
        tape.step(own)
        limited += (reactances(tape) > 0.0).any(axis=1)
        over_power = np.minimum(over_power, tape.lanes.simulator.wtg_values("over_power").min(axis=1))
    assert (limited[[0, 2]] > 2).all() and over_power[1] < -1e-4


def test_the_gradient_goes_through_a_table_of_power_coefficients() -> None:
    tape = tape_of(**V1, suite="gusty", physics="nrel-5mw")
    agrees(tape, drawn(tape), actions_of(tape, 200, 0.2))


def test_hydro_governors_are_refused() -> None:
    hydro = [dataclasses.replace(m, governor=HydroGovernorParameters()) for m in modified_ieee14().machines]
    case = dataclasses.replace(modified_ieee14(), machines=tuple(hydro))
    with pytest.raises(ValueError, match="hydro"):
        require_known(build_plant(PlantSettings(case=case)))


#: Kernels of a control step that gradients do not go through: what they do counts as given.
GIVEN = {
    "_count_step",
    "apply_network_changes",
    "arrived_row",
    "changes_due",
    "enter_interval",
    "sample_grid",
    "newest_row",
    "noise_key",
    "normal",
    "protections_sample",
    "report",
    "shed_load",
    "update_status",
}
#: Those that the way back has rules of its own for; the kernels that they call are traced.
FOLLOWED = {
    "limit_currents",
    "advance_stage",
    "advance_interval",
    "advance_step",
    "derivatives",
    "end_step",
    "show_delayed",
}


def test_every_kernel_of_a_step_is_traced_or_counts_as_given(monkeypatch: pytest.MonkeyPatch) -> None:
    tape = tape_of(**V1)
    lanes, simulator = tape.lanes, tape.lanes.simulator
    called: set[str] = set()
    own = kernel_programs.retargeted

    def noted(function: Any, *given: Any) -> Any:
        done: dict[Any, Any] = given[1] if len(given) > 1 else {}
        found = own(function, given[0] if given else kernel_programs.ARITHMETIC, done)
        called.update(source.__name__ for source in done)
        return found

    monkeypatch.setattr(kernel_programs, "retargeted", noted)
    programs_of(simulator.plant, lanes.task, simulator.layout.n_rows, lanes.n_action)
    known = GIVEN | set(kernel_programs.ARITHMETIC)
    found = kernels_of(step_blocks, known)
    assert found - called - known == FOLLOWED
    assert found >= GIVEN


def kernels_of(function: Any, known: set[str]) -> set[str]:
    """Return the names of all compiled functions that one calls, except those that only known ones call."""
    found: set[str] = set()
    open_ = [function.py_func]
    while open_:
        source = open_.pop()
        for name in source.__code__.co_names:
            callee = getattr(source.__globals__.get(name), "py_func", None)
            if callee is not None and callee.__name__ not in found:
                found.add(callee.__name__)
                if callee.__name__ not in known:
                    open_.append(callee)
    return found
