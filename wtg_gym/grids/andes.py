"""Cases of other programs, read by ANDES in a process of its own: RAW with DYR, xlsx, json, MATPOWER.

ANDES (https://docs.andes.app) is GPL: it is run, never imported. Its command converts a case to JSON, whose tables are
turned into a :class:`~wtg_gym.physics.grid.Grid` here. Its parameters and their bases are those of its documentation.
"""

from __future__ import annotations

import json
import math
import re
import shutil
import subprocess
import tempfile
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from wtg_gym.grids.typical import TYPICAL_EXCITER, TYPICAL_GOVERNOR, typical_machine
from wtg_gym.physics.grid import MODELS, Branch, Bus, Grid, NetworkCase
from wtg_gym.physics.machine import saturation_constants
from wtg_gym.physics.machine_parameters import SynchronousMachineParameters, classical_machine
from wtg_gym.physics.network import LEAST_IMPEDANCE
from wtg_gym.ranges import require_range

Row = Mapping[str, Any]
Tables = Mapping[str, Sequence[Row]]
Record = TypeVar("Record")
#: How long the conversion may take [s]: the first one lets ANDES generate its code.
_LIMIT_S = 600.0
#: Models of PSS/E that ANDES itself reads as others.
_READ_AS = {"GENSAL": "GENROU", "ESAC6A": "SEXS", "SCRX": "SEXS", "EXPIC1": "SEXS", "GGOV1": "TGOV1"}
#: Reactance that a branch without impedance gets [p.u.].
_LEAST_REACTANCE = 5e-4
#: Share of x'' that a leakage reactance has at most, so that the order x'' > x_l holds.
_LEAKAGE = 0.8
#: Power from which on a limit means none [p.u.]; ANDES has 999, files 9900 or 9999 Mvar.
_UNLIMITED = 90.0
#: Largest saturation that is taken: data beyond it are no machine's.
_LARGEST_SATURATION = 10.0
#: Regulator's limit where the data say 0, which means none [p.u.].
_NO_LIMIT = 999.0
_TGOV1 = (
    "droop_pu=R/ gate_time_s=T1 lead_time_s=T2 reheat_time_s=T3 gate_min_pu=VMIN* gate_max_pu=VMAX* "
    "turbine_damping_pu=Dt*"
)
_IEEET1 = (
    "sensing_time_s=TR regulator_gain=KA regulator_time_s=TA regulator_min_pu=VRMIN regulator_max_pu=VRMAX "
    "exciter_gain=KE exciter_time_s=TE saturation_voltage_1_pu=E1 saturation_1=SE1 saturation_voltage_2_pu=E2 "
    "saturation_2=SE2 "
)
#: Parameters of controls by ANDES' names, of which 1/ takes the inverse. From the base of the turbine to that of its
#: machine a value is multiplied (*) or divided (/) by the ratio of their ratings. ANDES has no STAB1.
_CONTROLS = {
    "SEXS": "gain=K lead_lag_ratio=TATB lag_time_s=TB exciter_time_s=TE field_min_pu=EMIN field_max_pu=EMAX",
    "IEEET1": _IEEET1 + "feedback_gain_s=KF feedback_time_s=TF",
    "IEEEX1": _IEEET1 + "feedback_gain_s=KF1 feedback_time_s=TF1 lead_time_s=TC lag_time_s=TB",
    "TGOV1": _TGOV1,
    # The other place of its set-point does not count: it stands still.
    "TGOV1N": _TGOV1,
    # Its D_t multiplies the gate, which is on the other base already.
    "HYGOV": "droop_pu=R/ temporary_droop_pu=r/ reset_time_s=Tr filter_time_s=Tf gate_time_s=Tg "
    "gate_rate_limit_pu_s=VELM* gate_min_pu=GMIN* gate_max_pu=GMAX* water_time_s=Tw/ turbine_gain=At "
    "turbine_damping_pu=Dt no_load_flow_pu=qNL*",
    "IEEEG1": "droop_pu=1/K/ lag_time_s=T1 lead_time_s=T2 valve_time_s=T3 opening_rate_pu_s=UO* closing_rate_pu_s=UC* "
    "gate_min_pu=PMIN* gate_max_pu=PMAX* pass_time_1_s=T4 pass_time_2_s=T5 pass_time_3_s=T6 pass_time_4_s=T7 "
    "fraction_1=K1 fraction_2=K3 fraction_3=K5 fraction_4=K7",
    "IEESGO": "droop_pu=1/K1/ lag_time_s=T1 lead_time_s=T2 governor_time_s=T3 inlet_time_s=T4 reheat_time_s=T5 "
    "crossover_time_s=T6 fraction_2=K2 fraction_3=K3 gate_min_pu=PMIN* gate_max_pu=PMAX*",
    "GAST": "droop_pu=R/ valve_time_s=T1 turbine_time_s=T2 exhaust_time_s=T3 load_limit_pu=AT* temperature_gain=KT "
    "gate_min_pu=VMIN* gate_max_pu=VMAX* turbine_damping_pu=Dt*",
    "IEEEST": "filter_a1_s=A1 filter_a2_s2=A2 filter_a3_s=A3 filter_a4_s2=A4 filter_a5_s=A5 filter_a6_s2=A6 "
    "lead_time_1_s=T1 lag_time_1_s=T2 lead_time_2_s=T3 lag_time_2_s=T4 washout_gain_s=T5 washout_time_s=T6 gain=KS "
    "signal_min_pu=LSMIN signal_max_pu=LSMAX voltage_min_pu=VCL voltage_max_pu=VCU",
}
_MACHINES = ("GENROU", "GENCLS")
#: Tables that are read apart from controls, and those that say nothing about the grid's models.
_NO_CONTROLS = {
    "Bus", "PQ", "PV", "Slack", "Shunt", "Line", "GENROU", "GENCLS", "_config", "_read_as", "Summary", "Toggle",
    "Toggler", "Fault", "Alter", "TimeSeries", "Area", "Zone", "Owner", "Output", "COI", "COI2", "ACE", "ACEc",
    "BusFreq", "BusROCOF", "PLL1", "PLL2", "PMU",
}  # fmt: skip


def convert(case: Path, dynamic: Path | None = None, program: str = "andes") -> Tables:
    """Return the tables of a case, as ANDES reads it; models that it passes over have one too.

    Args:
        case: a file that ANDES reads.
        dynamic: a DYR file with its machines.
        program: ANDES' command.

    Raises:
        ValueError: a file or the program is missing, or ANDES cannot read the case; the message has its last lines.
    """
    for path in (case, dynamic):
        if path is not None and not path.is_file():
            raise ValueError(f"there is no file {path}")
    command = shutil.which(program)
    if command is None:
        raise ValueError(f"there is no program {program!r}: install ANDES (pip install andes), or name its command")
    with tempfile.TemporaryDirectory() as folder:
        added = [] if dynamic is None else ["--addfile", str(dynamic.resolve())]
        arguments = ["run", str(case.resolve()), *added, "--convert", "json", "--output-path", folder]
        try:
            done = subprocess.run([command, *arguments], capture_output=True, text=True, timeout=_LIMIT_S, cwd=folder)
        except subprocess.TimeoutExpired as error:
            raise ValueError(f"ANDES did not convert {case} within {_LIMIT_S:g} s") from error
        said = done.stdout + done.stderr
        written = sorted(Path(folder).glob("*.json"))
        if not written:
            lines = [line.strip() for line in said.splitlines() if line.strip() and not line.startswith("->")]
            raise ValueError(f"ANDES cannot read {case}: {'; '.join(lines[-4:]) or 'it says nothing'}")
        # What an xlsx file leaves empty is NaN.
        tables: dict[str, Any] = json.loads(written[0].read_text(encoding="utf-8"), parse_constant=lambda _: None)
    passed_over = [{"idx": "of the DYR file, which ANDES does not read,"}]
    for names in re.findall(r"Models not yet supported: (.*)|PSS/E Model <(\w+)> is not supported", said):
        tables.update(dict.fromkeys(re.findall(r"\w+", "".join(names)), passed_over))
    text = "" if dynamic is None else dynamic.read_text(errors="replace")
    tables["_read_as"] = [{"idx": model} for model in _READ_AS if re.search(rf"'\s*{model}\s*'", text)]
    return tables


def grid_of(tables: Tables, name: str, *, substitute: bool = False) -> Grid:
    """Return the grid of ANDES' tables, without WTG groups.

    Args:
        tables: as :func:`convert` returns them.
        name: of the grid.
        substitute: put typical controls in the place of models that are not here, or leave those out, instead of
            refusing them.

    Raises:
        ValueError: a model is not here, a parameter is out of its range, or the network is none; the message says
            what is wrong.
    """
    case = _Case(tables)
    branches, machines = case.branches(), case.machines()
    buses = list(case.buses())
    slacks = sorted({case.numbers[row["bus"]] for row in case.rows["Slack"]})
    if len(slacks) != 1:
        raise ValueError(f"the case must have one slack bus, got {slacks}")
    if case.unknown and not substitute:
        said = ", ".join(f"{model} ({n})" for model, n in case.unknown.items())
        raise ValueError(f"models that are not here: {said}; --substitute leaves them out, or puts typical ones there")
    return Grid(
        case=NetworkCase(
            name=name, base_mva=case.base, frequency_hz=case.config("freq", 60.0), slack_bus=slacks[0],
            buses=tuple(buses), branches=tuple(branches), machines=tuple(machines),
        ),
        repairs=tuple(case.repairs), substitutions=tuple(case.substitutions),
    )  # fmt: skip


class _Case:
    """The tables of a case, what was done to them, and which models are not here."""

    def __init__(self, tables: Tables) -> None:
        self.repairs, self.substitutions, self.unknown = list[str](), list[str](), Counter[str]()
        self.rows = defaultdict[str, list[Row]](list)
        for model, rows in tables.items():
            self.rows[model] = [row for row in rows if row.get("u", 1.0)]
        self._keep(("bus", "bus1", "bus2"), {row["idx"] for row in self.rows["Bus"]})
        joined = {row[end] for row in self.rows["Line"] for end in ("bus1", "bus2")}
        for row in self.rows["Bus"]:
            if row["idx"] not in joined:
                self.repairs.append(f"bus {row['idx']} has no branch in service; it is left out, with what is there")
        self.rows["Bus"] = [row for row in self.rows["Bus"] if row["idx"] in joined]
        self._keep(("bus",), joined)
        self._keep(("syn",), {row["idx"] for model in _MACHINES for row in self.rows[model]})
        self.exciters = {
            row["idx"]: row["syn"]
            for model, rows in self.rows.items()
            for row in rows
            if _kind(model, row) == "exciter"
        }
        self._keep(("avr",), set(self.exciters))
        self.base = self.config("mva", 100.0)
        self.volts = {row["idx"]: row["Vn"] for row in self.rows["Bus"]}
        #: Admittances of lines and shunts at each bus [p.u.].
        self.shunts = defaultdict[Any, complex](complex)
        whole = all(str(index).isdigit() and int(index) > 0 for index in self.volts)
        self.numbers = {index: int(index) if whole else place for place, index in enumerate(self.volts, start=1)}
        if not whole:
            self.repairs.append("bus numbers: " + ", ".join(f"{index} = {n}" for index, n in self.numbers.items()))
        for row in self.rows["_read_as"]:
            self.substitutions.append(f"{row['idx']}: ANDES reads it as {_READ_AS[row['idx']]}")

    def _keep(self, columns: Sequence[str], kept: set[Any]) -> None:
        """Take away the rows that stand at something that is not kept."""
        able = {None, *kept}
        for model, rows in self.rows.items():
            self.rows[model] = [row for row in rows if all(row.get(name) in able for name in columns)]

    def config(self, key: str, default: float) -> float:
        """Return a number of the system."""
        found = [row["value"] for row in self.rows["_config"] if (row["section"], row["key"]) == ("System", key)]
        return float(found[0]) if found else default

    @property
    def sources(self) -> Iterator[tuple[str, Row]]:
        """The rows of the power flow that give power, with their models."""
        return ((model, row) for model in ("PV", "Slack") for row in self.rows[model])

    def buses(self) -> Iterator[Bus]:
        """Yield the buses; a source without a machine is a load of negative power, as far as there are machines."""
        loads, volts = defaultdict[Any, complex](complex), {}
        driven = {row["gen"] for model in _MACHINES for row in self.rows[model]}
        for row in self.rows["PQ"]:
            loads[row["bus"]] += self.base * complex(row["p0"], row["q0"])
        for model, row in self.sources:
            if row["idx"] in driven or not driven:
                volts[row["bus"]] = row["v0"]
                continue
            loads[row["bus"]] -= self.base * complex(row["p0"], row["q0"])
            self.substitutions.append(f"{model} {row['idx']} at bus {row['bus']} has no machine: a load of -P, -Q")
        for row in self.rows["Shunt"]:
            scale = row["Sn"] / self.base * (self.volts[row["bus"]] / row["Vn"]) ** 2
            self.shunts[row["bus"]] += scale * complex(row["g"], row["b"])
        for row in self.rows["Bus"]:
            index = row["idx"]
            load, shunt, place = loads[index], self.base * self.shunts[index], (row.get("xcoord"), row.get("ycoord"))
            x, y = place if any(place) else (None, None)
            yield _made(
                f"bus {index}", Bus, number=self.numbers[index], load_mw=load.real, load_mvar=load.imag,
                shunt_mw=shunt.real, shunt_mvar=shunt.imag, voltage_pu=volts.get(index), x=x, y=y,
            )  # fmt: skip

    def branches(self) -> list[Branch]:
        """Return the branches on the system's base."""
        found = []
        for row in self.rows["Line"]:
            ends = [row["bus1"], row["bus2"]]
            name = "branch {}-{}".format(*ends)
            scale = self.base / row["Sn"] * (row["Vn1"] / self.volts[ends[0]]) ** 2
            reactance, tap = scale * row["x"], row["tap"] or 1.0
            if math.hypot(reactance, scale * row["r"]) < LEAST_IMPEDANCE:
                reactance = _LEAST_REACTANCE
                self.repairs.append(f"{name} has no impedance; it gets {reactance:g} p.u. of reactance")
            if row["phi"]:
                # Load noise, which every suite has, needs a network without them.
                self._lacks("phase shifter", f"{name}: its shift of {math.degrees(row['phi']):.3g}° is taken as 0")
            half = complex(row.get("g", 0.0)) / 2.0
            for index, y in zip(ends, (complex(row["g1"], row["b1"]), complex(row["g2"], row["b2"])), strict=True):
                self.shunts[index] += (y + half) / scale / (tap**2 if index == ends[0] else 1.0)
            values = {"resistance": scale * row["r"], "reactance": reactance, "charging": row["b"] / scale, "tap": tap}
            found.append(_made(name, Branch, from_bus=self.numbers[ends[0]], to_bus=self.numbers[ends[1]], **values))
        return found

    def _lacks(self, model: str, done: str) -> None:
        """Count a model that is not here, and say what was done about it."""
        self.unknown[model] += 1
        self.substitutions.append(done)

    def machines(self) -> list[SynchronousMachineParameters]:
        """Return the machines, typical ones for all sources of the power flow in a case without any."""
        controls, sources, found = self._controls(), {row["idx"]: row for _, row in self.sources}, []
        for model in _MACHINES:
            for row in self.rows[model]:
                source, own = sources.get(row["gen"], {"p0": 0.0, "Sn": self.base}), controls[row["idx"]]
                common = {
                    "bus": self.numbers[row["bus"]], "rating_mva": row["Sn"], "two_h_s": row["M"],
                    "damping_pu": row["D"], "dispatch_mw": self.base * source["p0"] * row.get("gammap", 1.0),
                    # Of what its source gives: shares of one source are on its one rating.
                    "reactive_weight": source["Sn"] * row.get("gammaq", 1.0),
                }  # fmt: skip
                scale = (row.get("Vn", self.volts[row["bus"]]) / self.volts[row["bus"]]) ** 2
                at, common["resistance"] = f"machine {row['idx']}", scale * row["ra"]
                if model == "GENROU":
                    values = {"exciter": None, **common, **self._genrou(at, row, scale), **own}
                    found.append(_made(at, SynchronousMachineParameters, **values))
                    continue
                for kind in sorted(own.keys() - {"governor"}):
                    self.repairs.append(f"{at} is a constant voltage: its {kind} is left out")
                    del own[kind]
                values = {"x_d_transient": scale * row["xd1"], "x_leakage": 0.0, **common, **own}
                found.append(_made(at, classical_machine, **values))
        if not any(self.rows[model] for model in _MACHINES):
            for model, row in self.sources:
                power, slack = self.base * complex(row["p0"], row["q0"]), model == "Slack"
                # Before a power flow nobody knows what it gives: it is able to give the most that its row says.
                most = (row.get("qmax", 0.0), row.get("pmax", 0.0) if slack else 0.0)
                least = self.base * max((limit for limit in most if limit < _UNLIMITED), default=0.0)
                found.append(typical_machine(self.numbers[row["bus"]], power, least, slack=slack))
            self.substitutions.append(f"the case has no machines; all {len(found)} are typical ones")
        return found

    def _genrou(self, at: str, row: Row, scale: float) -> dict[str, float]:
        """Return the parameters of a round rotor, whose reactances a factor brings to the voltage of its bus."""
        x = {name: scale * row[name] for name in ("xd", "xq", "xd1", "xq1", "xd2", "xq2", "xl")}
        least, subtransient, leakage = min(x["xd1"], x["xq1"]), x["xd2"], x["xl"]
        if x["xq2"] != subtransient:
            self.repairs.append(f"{at}: x''_q {x['xq2']:g} p.u. is taken as x''_d, {subtransient:g} p.u.")
        if subtransient > least:
            self.repairs.append(f"{at}: x'' {subtransient:g} p.u. exceeds x' and is taken as {least:g} p.u.")
            subtransient = least
        if leakage >= subtransient:
            self.repairs.append(
                f"{at}: leakage reactance {leakage:g} p.u. is not below x''; {_LEAKAGE:g} x'' stands instead"
            )
            leakage = _LEAKAGE * subtransient
        times = {
            "t_d0_transient_s": "Td10", "t_q0_transient_s": "Tq10", "t_d0_subtransient_s": "Td20",
            "t_q0_subtransient_s": "Tq20",
        }  # fmt: skip
        values = {name: row[theirs] for name, theirs in times.items()}
        for name in [name for name, value in values.items() if value == 0.0]:
            values[name] = getattr(typical_machine(1), name)
            self.repairs.append(f"{at}: {times[name]} is 0 s; {values[name]:g} s, a typical value, stands instead")
        (_, first), (_, second) = self._saturation(at, (1.0, row.get("S10", 0.0)), (1.2, row.get("S12", 0.0)))
        return {
            "x_d": x["xd"], "x_q": x["xq"], "x_d_transient": x["xd1"], "x_q_transient": x["xq1"],
            "x_subtransient": subtransient, "x_leakage": leakage, "saturation_1_0": first, "saturation_1_2": second,
            **values,
        }  # fmt: skip

    def _saturation(self, at: str, *points: tuple[float, float]) -> list[tuple[float, float]]:
        """Return two points of a saturation in order, or without one where they mean none (0 and 1), or nothing."""
        first, second = sorted(points)
        if (first[1], second[1]) != (0.0, 1.0):
            try:
                saturation_constants(at, first, second)
                require_range(f"{at}: saturation", second[1], 0.0, _LARGEST_SATURATION, "")
                return [first, second]
            except ValueError as error:
                self.repairs.append(f"{error}; it is left out")
        return [(0.0, 0.0), (1.0, 0.0)]

    def _controls(self) -> dict[Any, dict[str, Any]]:
        """Return exciter, governor and stabiliser of each machine by its index."""
        machines = {row["idx"]: row for model in _MACHINES for row in self.rows[model]}
        found: dict[Any, dict[str, Any]] = {index: {} for index in machines}
        for model in [model for model in self.rows if model not in _NO_CONTROLS]:
            for row in self.rows[model]:
                machine, kind, what = row.get("syn", self.exciters.get(row.get("avr"))), _kind(model, row), model
                at = f"{model} {row.get('idx')}" if machine is None else f"{model} of machine {machine}"
                if what == "IEEEST" and row["MODE"] != 1.0:
                    what = f"{model} with input {row['MODE']:g}"
                if model == "IEEEG1" and row.get("syn2") in machines:
                    what = f"{model} of two machines"
                if what in _CONTROLS:
                    if control := self._control(at, model, row, machines[machine]["Sn"]):
                        found[machine][kind] = control
                elif kind in ("exciter", "governor"):
                    for each in machines.keys() & {machine, row.get("syn2")}:
                        found[each].setdefault(kind, TYPICAL_EXCITER if kind == "exciter" else TYPICAL_GOVERNOR)
                    self._lacks(what, f"{at}: a typical {kind} stands in its place")
                else:
                    self._lacks(what, f"{at.replace(model, what, 1)} is left out")
        return found

    def _control(self, at: str, model: str, given: Row, rating: float) -> Any:
        """Return the parameters of a control on the base of its machine, whose rating is given [MVA]."""
        row, ratio = dict(given), (given.get("Tn") or rating) / rating
        if model in ("IEEET1", "IEEEX1"):
            points = self._saturation(at, (row["E1"], row["SE1"]), (row["E2"], row["SE2"]))
            (row["E1"], row["SE1"]), (row["E2"], row["SE2"]) = points
            if row["VRMAX"] == 0.0:
                row["VRMAX"] = _NO_LIMIT
                self.repairs.append(f"{at}: VRMAX = 0 means no limit, {_NO_LIMIT:g} p.u.")
        if model == "IEEEST":
            row.update({name: row[name] if 0.0 < abs(row[name]) < _NO_LIMIT else 0.0 for name in ("VCL", "VCU")})
        values = {}
        for name, theirs in (pair.split("=") for pair in _CONTROLS[model].split()):
            column = theirs.removeprefix("1/").rstrip("*/")
            if theirs.startswith("1/") and row[column] == 0.0:
                self.repairs.append(f"{at}: {column} = 0, so that it does not act; it is left out")
                return None
            value = 1.0 / row[column] if theirs.startswith("1/") else row[column]
            values[name] = value * {"*": ratio, "/": 1.0 / ratio}.get(theirs[-1], 1.0)
        return _made(at, MODELS["TGOV1" if model == "TGOV1N" else model], **values)


def _kind(model: str, row: Row) -> str:
    """Return what a row of a control acts as, by the columns that ANDES gives to each kind."""
    if "avr" in row:
        return "stabiliser"
    # Shafts name a machine too.
    return "" if "syn" not in row or model == "Shaft5" else "governor" if {"wref0", "Tn"} & set(row) else "exciter"


def _made(what: str, record: Callable[..., Record], **values: Any) -> Record:
    """Return a record of checked values; its error says what it is of."""
    try:
        return record(**values)
    except ValueError as error:
        raise ValueError(f"{what}: {re.sub(r'^[A-Z][A-Za-z]+(: |[.])', '', str(error))}") from error
