"""Cases that pypowsybl (https://powsybl.org) reads and solves: RAW, RAWX, CGMES, UCTE, IEEE-CDF, PowerFactory, XIIDM.

What its reader of RAW passes over is looked for in the file's sections: tables of impedance correction, devices that no
section of it knows, the initial susceptance of switched shunts, which it rounds to a step, and the bases of machines.
"""

from __future__ import annotations

import cmath
import csv
import json
import math
import re
import tempfile
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from wtg_gym.extras import install_advice
from wtg_gym.files import read_text
from wtg_gym.grids.solved_case import BASE_MVA, Infeed, SolvedCase, TwoPort, refuse_large, refuse_unread
from wtg_gym.physics.network import LEAST_IMPEDANCE

#: Sections of RAW 32 and 33 in their order, and those of 35.
_SECTIONS = [
    *("bus", "load", "fixshunt", "generator", "acline", "transformer", "area", "twotermdc", "vscdc", "impcor"),
    *("ntermdc", "msline", "zone", "iatrans", "owner", "facts", "swshunt", "gne", "indmach"),
]
_SECTIONS_35 = ["system", *_SECTIONS[:5], "sysswd", *_SECTIONS[5:], "substation"]
#: Those that pypowsybl passes over, as messages call them.
_PASSED_OVER = {
    "impcor": "impedance-correction", "ntermdc": "multi-terminal-dc", "gne": "gne-device",
    "indmach": "induction-machine",
}  # fmt: skip
#: Places of numbers in the records of RAW 33 and 35.
_FIELDS = {
    33: {
        "mbase": 8,
        "zr": 9,
        "zx": 10,
        "wmod": 26,
        "binit": 9,
    },
    35: {
        "mbase": 9,
        "zr": 10,
        "zx": 11,
        "wmod": 28,
        "binit": 11,
    },
}
#: Tables of pypowsybl that have no place in a grid, with the column of their power.
_UNREAD = {
    "dc-line": ("hvdc_lines", "target_p"), "svc": ("static_var_compensators", ""),
    "dc-grid-line": ("dc_lines", ""), "voltage-source-converter": ("voltage_source_converters", "target_p"),
}  # fmt: skip
#: Whatever else may move in its power flow stands still.
_FLOW = {
    "distributed_slack": False, "use_reactive_limits": False, "transformer_voltage_control_on": False,
    "shunt_compensator_voltage_control_on": False, "phase_shifter_regulation_on": False, "hvdc_ac_emulation": False,
}  # fmt: skip
_OF_PROVIDER = {
    "newtonRaphsonConvEpsPerEq": "1e-10", "lowImpedanceThreshold": str(LEAST_IMPEDANCE), "useLoadModel": "true",
    "generatorsWithZeroMwTargetAreNotStarted": "false", "minPlausibleTargetVoltage": "0.1",
    "maxPlausibleTargetVoltage": "10", "minRealisticVoltage": "0.1", "maxRealisticVoltage": "10",
    "maxNewtonRaphsonIterations": "30", "plausibleActivePowerLimit": "1e9",
}  # fmt: skip


def read_powsybl(path: Path, frequency_hz: float | None, drop: Collection[str]) -> SolvedCase:
    """Return the case of a file, as pypowsybl solves it.

    Raises:
        ValueError: pypowsybl is missing, cannot read the file, or finds no power flow; or the file has elements that a
            grid does not, and `drop` does not name their type.
    """
    try:
        import pypowsybl
    except ImportError as error:
        raise ValueError(f"it needs pypowsybl; {install_advice('grids')}") from error
    notes: list[str] = []
    raw = _Raw(path) if path.suffix.lower() in (".raw", ".rawx") else None
    # Errors of pypowsybl are of any kind.
    try:
        if raw is None:
            net = pypowsybl.network.load(str(path))
        else:
            with tempfile.TemporaryDirectory() as folder:
                copy = Path(folder) / path.name.replace(path.suffix, path.suffix.lower())
                copy.write_text(raw.text)
                net = pypowsybl.network.load(str(copy))
    except Exception as error:
        which = "" if raw is None else f" as RAW of version {raw.version:g} (32, 33 and 35 are read)"
        raise ValueError(f"pypowsybl cannot read it{which}: {error}") from error
    unread = {} if raw is None else {kind: (n, 0.0) for kind, n in raw.passed_over()}
    for kind, (name, column) in _UNREAD.items():
        rows = getattr(net, f"get_{name}")()
        on = rows[rows[[c for c in rows if c.startswith("connected")]].all(axis=1)] if len(rows) else rows
        unread[kind] = len(on), float(abs(on[column]).sum()) if column else 0.0
        if kind in drop and len(rows):
            ends = (net.get_lcc_converter_stations(), net.get_vsc_converter_stations()) if kind == "dc-line" else ()
            stations = [each for table in ends for each in table.index]
            try:
                net.remove_elements([*rows.index, *stations])
            except Exception as error:
                raise ValueError(f"pypowsybl cannot leave out {kind}: {error}") from error
    refuse_unread(unread, drop, notes)
    refuse_large(len(net.get_buses()))
    try:
        return _Tables(pypowsybl, net, path.stem, raw, notes).case(frequency_hz)
    except ValueError as error:
        raise ValueError(f"as RAW of version {raw.version:g}, {error}" if raw is not None else str(error)) from error


class _Raw:
    """The sections of a RAW or RAWX file, with what pypowsybl passes over, and its text as pypowsybl should read it."""

    def __init__(self, path: Path) -> None:
        self.text = read_text(path, "case")
        self.records: dict[str, list[list[Any]]] = {}
        self.version, self.frequency_hz = 0.0, 0.0
        self._columns: dict[str, list[str]] = {}
        if path.suffix.lower() == ".rawx":
            self._read_rawx()
        else:
            self._read_raw()

    def _read_raw(self) -> None:
        lines = self.text.splitlines()
        remarks = ("@!",)
        starts = [place for place, line in enumerate(lines) if not line.startswith(remarks)]
        header = _fields(lines[starts[0]]) if starts else []
        try:
            self.version = float(header[2])
        except (IndexError, ValueError) as error:
            raise ValueError("it is no RAW file: its first line must have three numbers or more") from error
        self.frequency_hz = _number(header, 5)
        queue = iter(_SECTIONS_35 if self.version >= 34 else _SECTIONS)
        section, written = next(queue), lines[: starts[2] + 1] if len(starts) > 2 else lines
        for line in lines[len(written) :]:
            if line.startswith(remarks):
                continue
            if re.match(r"\s*Q\s*$", line):
                break
            if re.match(r"\s*0\s*($|/|[A-Za-z])", line):
                section = next(queue, "")
            elif line.strip():
                fields = _fields(line)
                self.records.setdefault(section, []).append(fields)
                if section == "swshunt":
                    line = self._at_initial(fields)
            written.append(line)
        self.text = "\n".join([*written, "Q", ""])

    def _at_initial(self, fields: list[str]) -> str:
        """Return the record of a switched shunt with its initial susceptance as its only step."""
        place = self._place("binit")
        steps = ["1", "1", fields[place]] if self.version >= 34 else ["1", fields[place]]
        kept = [*fields[: place + 1], *steps] if _number(fields, place) else [*fields[:3], "0", *fields[4:]]
        return ",".join(f"'{each}'" if re.search(r"[A-Za-z ]", each) or not each else each for each in kept)

    def _read_rawx(self) -> None:
        try:
            data = json.loads(self.text)
            network = data["network"]
            case = dict(zip(network["caseid"]["fields"], network["caseid"]["data"], strict=False))
            self.version, self.frequency_hz = float(case.get("rev", 35)), float(case.get("basfrq", 0.0))
            for name, table in network.items():
                if table["data"] and isinstance(table["data"][0], list):
                    self.records[name] = table["data"]
            self._columns = {name: list(table["fields"]) for name, table in network.items()}
            for row in self.records.get("swshunt", []):
                at = {name: place for place, name in enumerate(self._columns["swshunt"])}
                steps = {"n1": 1, "b1": row[at["binit"]]}
                for name in [name for name in at if re.fullmatch(r"[nb]\d", name)]:
                    row[at[name]] = steps.get(name, 0)
            self.text = json.dumps(data)
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise ValueError(f"it is no RAWX file: {error}") from error

    def _place(self, name: str) -> int:
        if columns := self._columns.get("generator"):
            return columns.index(name) if name in columns else len(columns)
        return _FIELDS[35 if self.version >= 34 else 33][name]

    def passed_over(self) -> Iterator[tuple[str, int]]:
        """Yield what pypowsybl passes over: type and number."""
        for section, kind in _PASSED_OVER.items():
            yield kind, len({fields[0] for fields in self.records.get(section, [])})
        series = [row for row in self.records.get("facts", []) if str(row[2]).strip("' ") not in ("0", "", "None")]
        yield "facts-series", len(series)

    def machines(self) -> dict[tuple[str, str], dict[str, float]]:
        """Return rating [MVA], source impedance [p.u.] and kind of wind machine by bus and id."""
        found, names = {}, ("mbase", "zr", "zx", "wmod")
        default = {"mbase": 0.0, "zr": 0.0, "zx": 1.0, "wmod": 0.0}
        for row in self.records.get("generator", []):
            values = {name: _number(row, self._place(name), default[name]) for name in names}
            found[str(row[0]).strip(), str(row[1]).strip("' ")] = values
        return found


def _fields(line: str) -> list[str]:
    line = re.sub(r"^((?:[^'/]|'[^']*')*)/.*", r"\1", line)
    fields = next(csv.reader([line], quotechar="'", skipinitialspace=True), [])
    return [each.strip() for each in (fields if len(fields) > 1 else line.replace("'", " ").split())]


def _number(fields: list[Any], place: int, default: float = 0.0) -> float:
    try:
        return float(fields[place])
    except (IndexError, TypeError, ValueError):
        return default


class _Tables:
    """A network of pypowsybl, solved, whose tables become a case."""

    def __init__(self, library: Any, net: Any, name: str, raw: _Raw | None, notes: list[str]) -> None:
        self.net, self.name, self.raw, self.notes = net, name, raw, notes
        self.slack = self._slack()
        self._solve(library)
        levels = net.get_voltage_levels()["nominal_v"]
        self.buses = net.get_buses()
        self.volts = {key: float(levels[level]) for key, level in self.buses["voltage_level_id"].items()}

    def _slack(self) -> str:
        slacks = sorted(set(self.net.get_extensions("slackTerminal").get("bus_id", [])) - {"", None})
        if len(slacks) > 1:
            raise ValueError(f"the case must have one slack bus, got {slacks}")
        if slacks:
            return str(slacks[0])
        generators = self.net.get_generators()
        able = generators[generators["connected"] & generators["voltage_regulator_on"]]
        if not len(able):
            raise ValueError("no generator in service holds a voltage")
        bus = str(able.loc[able["max_p"].idxmax(), "bus_id"])
        self.notes.append(f"the case names no slack bus; the one of the largest generator is taken: {bus}")
        return bus

    def _solve(self, library: Any) -> None:
        provider = {**_OF_PROVIDER, "slackBusSelectionMode": "NAME", "slackBusesIds": self.slack}
        statuses = []
        for start in ("UNIFORM_VALUES", "DC_VALUES", "PREVIOUS_VALUES"):
            mode = library.loadflow.VoltageInitMode.__members__[start]
            flow = library.loadflow.Parameters(
                voltage_init_mode=mode, read_slack_bus=False, provider_parameters=provider, **_FLOW
            )
            results = library.loadflow.run_ac(self.net, flow)
            statuses += [result.status_text for result in results[:1]]
            if results and results[0].status_text == "Converged":
                # Power that the slack bus gives beside what the case says of its generators [MW].
                self.missing_mw = float(results[0].slack_bus_results[0].active_power_mismatch)
                return
        raise ValueError(f"pypowsybl finds no power flow: {', '.join(dict.fromkeys(statuses))}")

    def case(self, frequency_hz: float | None) -> SolvedCase:
        """Return the case."""
        buses, known = self.buses, self.buses["synchronous_component"]
        part = known[self.slack]
        frequency = frequency_hz or (self.raw.frequency_hz if self.raw is not None else 0.0)
        if not frequency:
            frequency = 60.0 if self.net.source_format in ("IEEE-CDF", "PSS/E") else 50.0
            self.notes.append(f"the nominal frequency is taken as {frequency:g} Hz, which the file does not say")
        voltages = {
            key: cmath.rect(row.v_mag / self.volts[key], math.radians(row.v_angle)) if known[key] == part else 0j
            for key, row in zip(buses.index, buses.itertuples(), strict=True)
        }
        self.out = SolvedCase(
            name=self.name, library="pypowsybl", frequency_hz=frequency, slack=self.slack, voltages=voltages,
            numbers=self._numbers(), notes=self.notes,
        )  # fmt: skip
        self._add_lines()
        self._add_transformers()
        self._add_boundaries()
        self._add_injections()
        self._add_generators()
        return self.out

    def _numbers(self) -> dict[Any, int]:
        """Return the numbers in the names of buses, the least where several are one; none where one has no number."""
        views = self.net.get_bus_breaker_view_buses(all_attributes=True)
        numbers: dict[Any, int] = {}
        for name, key in views["bus_id"].items():
            if key not in self.volts:
                continue
            found = re.fullmatch(r"[A-Za-z]*-?0*(\d{1,9})", str(name))
            if not found or int(found[1]) < 1:
                return {}
            numbers[key] = min(numbers.get(key, 10**9), int(found[1]))
        return numbers if len(set(numbers.values())) == len(numbers) else {}

    def _admittance(self, siemens: complex, key: Any, other: Any = None) -> complex:
        """Return an admittance or, between two buses, a transfer [p.u.]."""
        return siemens * self.volts[key] * self.volts[key if other is None else other] / BASE_MVA

    def _add_branch(
        self,
        name: str,
        ends: tuple[Any, Any],
        ohms: complex,
        siemens: tuple[complex, complex],
        ratio: complex = 1.0 + 0j,
    ) -> None:
        """Add a branch: impedance and shunts [Ω, S] behind an ideal transformer, where V_1 · ratio is."""
        one, other = ends
        if not one and not other:
            return
        if not one or not other:
            # The open end leaves the shunt there behind the impedance.
            near, far = siemens if one else siemens[::-1]
            behind = far / (1.0 + ohms * far)
            self.out.shunts[one or other] += self._admittance(
                (near + behind) * (abs(ratio) ** 2 if one else 1.0), one or other
            )
            return
        base = self.volts[other] ** 2 / BASE_MVA
        tap = self.volts[other] / (self.volts[one] * ratio)
        self.out.branches.append(TwoPort(
            name=" ".join(name.split()), ends=ends, impedance=ohms / base,
            shunts=(siemens[0] * base, siemens[1] * base), tap=abs(tap), phase_rad=cmath.phase(tap),
        ))  # fmt: skip

    def _add_lines(self) -> None:
        for name, row in self.net.get_lines().iterrows():
            ends = row.bus1_id if row.connected1 else "", row.bus2_id if row.connected2 else ""
            shunts = complex(row.g1, row.b1), complex(row.g2, row.b2)
            self._add_branch(str(name), ends, complex(row.r, row.x), shunts)

    def _add_transformers(self) -> None:
        for name, row in self.net.get_2_windings_transformers(all_attributes=True).iterrows():
            ends = row.bus1_id if row.connected1 else "", row.bus2_id if row.connected2 else ""
            ohms = complex(row.r_at_current_tap, row.x_at_current_tap)
            shunts = complex(row.g_at_current_tap, row.b_at_current_tap), 0j
            self._add_branch(str(name), ends, ohms, shunts, cmath.rect(row.rho, math.radians(row.alpha)))
        for name, row in self.net.get_3_windings_transformers(all_attributes=True).iterrows():
            if not any(row[f"connected{leg}"] for leg in (1, 2, 3)):
                continue
            star = f"star of {name}"
            self.volts[star] = float(row.rated_u0)
            self.out.voltages[star] = cmath.rect(float(row.v) / row.rated_u0, math.radians(float(row.angle)))
            for leg in (1, 2, 3):
                values = {each: row[f"{each}{leg}_at_current_tap"] for each in "rxgb"}
                ratio = cmath.rect(row[f"rho{leg}"], math.radians(row[f"alpha{leg}"]))
                end = row[f"bus{leg}_id"] if row[f"connected{leg}"] else ""
                shunts = complex(values["g"], values["b"]), 0j
                self._add_branch(f"{name} winding {leg}", (end, star), complex(values["r"], values["x"]), shunts, ratio)

    def _add_boundaries(self) -> None:
        """Add lines to boundaries, which a tie line joins, and where one ends what it carries is a load."""
        for name, row in self.net.get_boundary_lines(all_attributes=True).iterrows():
            if not row.connected:
                continue
            key = f"boundary of {row.tie_line_id or name}"
            self.volts[key] = self.volts[row.bus_id]
            self.out.voltages.setdefault(key, complex(math.nan, 0.0))
            half = complex(row.g, row.b)
            self._add_branch(str(name), (row.bus_id, key), complex(row.r, row.x), (half, 0j))
            if not row.tie_line_id:
                self.out.loads[key] += complex(row.p0, row.q0)

    def _add_injections(self) -> None:
        for _, row in self.net.get_loads().iterrows():
            if not row.connected or not row.bus_id:
                continue
            taken, load = complex(row.p, row.q), complex(row.p0, row.q0)
            changed = cmath.isfinite(taken) and abs(taken - load) > 1e-4
            self.out.loads[row.bus_id] += taken if changed else load
            if changed:
                self.notes.append(
                    f"the load at {row.bus_id} is no constant power: {taken:.6g} MVA are taken, not {load:.6g}"
                )
        for key, row in self.buses.iterrows():
            self.out.loads[key] += complex(row.get("fictitious_p0", 0.0), row.get("fictitious_q0", 0.0))
        for _, row in self.net.get_shunt_compensators().iterrows():
            if row.connected and row.bus_id:
                self.out.shunts[row.bus_id] += self._admittance(complex(row.g, row.b), row.bus_id)

    def _add_generators(self) -> None:
        of_raw = {} if self.raw is None else self.raw.machines()
        tables = [("", self.net.get_generators()), ("static", self.net.get_batteries())]
        for role, table in tables:
            for name, row in table.iterrows():
                if not row.connected or not row.bus_id:
                    continue
                found = re.fullmatch(r"B(\d+)-G(.*)", str(name))
                place = (found[1], found[2].strip()) if found else ("", "1")
                data = of_raw.get(place, {"mbase": 0.0, "zr": 0.0, "zx": 1.0, "wmod": 0.0})
                source = "WIND" if data["wmod"] else row.get("energy_source", "OTHER")
                known = {"WIND": "wind", "SOLAR": "static"}
                taken = complex(row.p, row.q)
                limits = row.max_q, row.max_p if row.bus_id == self.slack else 0.0
                rating = data["mbase"] or (
                    float(row.get("rated_s", 0.0)) if np.isfinite(row.get("rated_s", np.nan)) else 0.0
                )
                self.out.infeeds.append(Infeed(
                    name=str(name), bus=row.bus_id, machine_id=place[1], role=role or known.get(source, "machine"),
                    power=-taken if cmath.isfinite(taken) else complex(row.target_p, row.target_q),
                    rating_mva=rating or None, impedance=complex(data["zr"], data["zx"]),
                    least_mva=max([float(v) for v in limits if v < 9000.0], default=0.0),
                ))  # fmt: skip
        slack = [each for each in self.out.infeeds if each.bus == self.slack and each.role == "machine"]
        for each in slack:
            each.power += self.missing_mw / len(slack)
