"""Cases that pypowsybl (https://powsybl.org) reads and solves: RAW, RAWX, CGMES, UCTE, IEEE-CDF, PowerFactory, XIIDM.

What its reader of RAW and RAWX passes over is looked for in the file's sections: tables of impedance correction,
devices that no section of it knows, the initial susceptance of switched shunts, which it rounds to a step, the sign of
YQ, buses that are out of service, records that are there twice or at no bus, and the bases of machines.
"""

import cmath
import json
import logging
import math
import re
import tempfile
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

from wtg_gym.files import parse_json, read_text
from wtg_gym.grids import solved_case
from wtg_gym.physics.network import LEAST_IMPEDANCE

#: Sections of RAW 32 and 33 in their order, and those of 35.
_SECTIONS = [
    *("bus", "load", "fixshunt", "generator", "acline", "transformer", "area", "twotermdc", "vscdc", "impcor"),
    *("ntermdc", "msline", "zone", "iatrans", "owner", "facts", "swshunt", "gne", "indmach"),
]
_SECTIONS_35 = ["system", *_SECTIONS[:5], "sysswd", *_SECTIONS[5:], "substation"]
#: Those that pypowsybl passes over, as messages call them.
_PASSED_OVER = {
    "impcor": "impedance-correction",
    "ntermdc": "multi-terminal-dc",
    "gne": "gne-device",
    "indmach": "induction-machine",
}
#: Fields of the records that are read here, in their order in RAW 35; 33 has those of :data:`_NEW` not.
_FIELDS = {
    "bus": "ibus name baskv ide area zone owner vm va",
    "load": "ibus loadid stat area zone pl ql ip iq yp yq owner scale intrpt dgenp dgenq dgenm",
    "fixshunt": "ibus shntid",
    "acline": "ibus jbus ckt",
    "transformer": "ibus jbus kbus ckt",
    "generator": "ibus machid pg qg qt qb vs ireg nreg mbase zr zx rt xt gtap stat rmpct pt pb baslod o1 f1 o2 f2 o3 "
    "f3 o4 f4 wmod wpf",
    "swshunt": "ibus shntid modsw adjm stat vswhi vswlo swreg nreg rmpct rmidnt binit s1 n1 b1",
    "facts": "name ibus jbus mode",
}
_NEW = {
    "generator": ("nreg", "baslod"),
    "load": ("dgenp", "dgenq", "dgenm"),
    "swshunt": ("shntid", "nreg", "s1"),
}
#: How many of the first fields tell the records of a section apart.
_KEYS = {"bus": 1, "load": 2, "generator": 2, "fixshunt": 2, "swshunt": 2, "acline": 3, "transformer": 4}
#: Sections that a file which does not end with Q may lack.
_LAST = ("gne", "indmach", "substation", "")
#: Types of a bus, and the one that is out of service.
_TYPES, _ISOLATED = ("", "1", "2", "3", "4"), "4"
#: Tables of what stands at buses, by whether it goes out of service with any of them.
_AT_BUSES = {
    **dict.fromkeys(("lines", "2_windings_transformers"), True),
    **dict.fromkeys(("loads", "generators", "batteries", "shunt_compensators", "static_var_compensators"), False),
    **dict.fromkeys(("lcc_converter_stations", "vsc_converter_stations", "3_windings_transformers"), False),
}
#: Ending that pypowsybl knows a format by, where another one is usual.
_ENDINGS = {".cdf": ".txt"}
#: Defaults of a generator in a RAW file.
_MACHINE = {"mbase": 0.0, "zr": 0.0, "zx": 1.0, "wmod": 0.0}
#: Tables of pypowsybl that have no place in a grid, with the column of their power.
_UNREAD = {
    "dc-line": ("hvdc_lines", "target_p"),
    "svc": ("static_var_compensators", ""),
    "dc-grid-line": ("dc_lines", ""),
    "voltage-source-converter": ("voltage_source_converters", "target_p"),
}
#: Whatever else may move in its power flow stands still.
_STILL = (
    "distributed_slack read_slack_bus use_reactive_limits hvdc_ac_emulation transformer_voltage_control_on "
    "shunt_compensator_voltage_control_on phase_shifter_regulation_on"
)
_FLOW: dict[str, Any] = dict.fromkeys(_STILL.split(), False)
_OF_PROVIDER = {
    **{"newtonRaphsonConvEpsPerEq": "1e-10", "maxNewtonRaphsonIterations": "30", "useLoadModel": "true"},
    **{"minPlausibleTargetVoltage": "0.1", "maxPlausibleTargetVoltage": "10", "plausibleActivePowerLimit": "1e9"},
    **{"minRealisticVoltage": "0.1", "maxRealisticVoltage": "10", "lowImpedanceThreshold": str(LEAST_IMPEDANCE)},
    "generatorsWithZeroMwTargetAreNotStarted": "false",
}


def read_powsybl(path: Path, frequency_hz: float | None, drop: Collection[str]) -> solved_case.SolvedCase:
    """Return the case of a file, as pypowsybl solves it.

    A ValueError says that it cannot read the file, or finds no power flow, or that the file has elements that a grid
    does not, of a type that `drop` does not name.
    """
    # Its import warns of what it does not need here.
    logging.getLogger("powsybl").setLevel(logging.ERROR)
    import pypowsybl

    notes: list[str] = []
    suffix = path.suffix.lower()
    raw = _Raw(path) if suffix in (".raw", ".rawx") else None
    # Errors of pypowsybl are of any kind.
    try:
        with tempfile.TemporaryDirectory() as folder:
            # Its readers go by endings, in small letters.
            read = path.with_suffix(_ENDINGS.get(suffix, suffix))
            if raw is not None or read != path:
                read = Path(folder) / read.name
                read.write_bytes(path.read_bytes() if raw is None else raw.text.encode())
            net = pypowsybl.network.load(str(read))
    except Exception as error:
        which = "" if raw is None else f" as RAW of version {raw.version:g}"
        raise ValueError(f"pypowsybl cannot read it{which}: {error}") from error
    if raw is None and net.source_format == "PSS/E" and "iidm" not in path.suffix.lower():
        # What pypowsybl passes over would not be seen.
        raise ValueError("a case of PSS/E is read from its .raw or .rawx file only, not from an archive")
    unread: dict[str, tuple[int, float]] = {}
    if raw is not None:
        _switch_off(net, raw, notes)
        unread |= {kind: (n, 0.0) for kind, n in raw.passed_over()}
        if raw.records["swshunt"]:
            what = "switched shunts stand at their initial susceptance BINIT"
            notes.append(f"{what}, which pypowsybl would round to a step")
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
    solved_case.refuse_unread(unread, drop, notes)
    solved_case.refuse_large(len(net.get_buses()))
    try:
        return _Tables(pypowsybl, net, path.stem, raw, notes).case(frequency_hz)
    except ValueError as error:
        raise ValueError(f"as RAW of version {raw.version:g}, {error}" if raw is not None else str(error)) from error


def _buses(net: Any) -> dict[int, str]:
    """Return the bus of each number in the names of buses; nothing where one has no number of its own."""
    buses: dict[int, str] = {}
    for name, key in net.get_bus_breaker_view_buses(all_attributes=True)["bus_id"].items():
        digits = re.fullmatch(r"[A-Za-z]*-?0*([1-9]\d{0,8})", str(name))
        if key and (not digits or buses.setdefault(int(digits[1]), key) != key):
            return {}
    return buses


def _switch_off(net: Any, raw: "_Raw", notes: list[str]) -> None:
    """Take out of service what is at buses that are, which pypowsybl does not."""
    if not (off := [row["ibus"] for row in raw.records["bus"] if row.get("ide") == _ISOLATED]):
        return
    names = {f"B{number}" for number in off}
    if missing := names - set(net.get_bus_breaker_view_buses().index):
        raise ValueError(f"bus {min(missing)[1:]} is of type 4, out of service, and has nodes of a substation")
    load_mw = 0.0
    for kind, both in _AT_BUSES.items():
        table = getattr(net, f"get_{kind}")(all_attributes=True)
        for side in ("", "1", "2", "3"):
            if (column := f"bus_breaker_bus{side}_id") not in table:
                continue
            at = table[table[column].isin(names) & table[f"connected{side}"]]
            if len(at):
                load_mw += at["p0"].sum() if kind == "loads" else 0.0
                ends = dict.fromkeys(("connected1", "connected2") if both else (f"connected{side}",), [False] * len(at))
                getattr(net, f"update_{kind}")(id=list(at.index), **ends)
    notes.append(solved_case.OFF.format(load_mw, solved_case.listed(off)))


class _Raw:
    """The records of a RAW or RAWX file by section, and its text as pypowsybl should read it."""

    def __init__(self, path: Path) -> None:
        self.records = defaultdict[str, list[dict[str, str]]](list)
        self._seen = set[tuple[str, str]]()
        text = read_text(path, "case", or_latin=True)
        self.text = self._read_json(text) if path.suffix.lower() == ".rawx" else self._read_lines(text)
        self._check_buses()

    def _read_json(self, text: str) -> str:
        network = parse_json(text, "it")
        network = network.get("network") if isinstance(network, dict) else None
        if not isinstance(network, dict) or not network.get("caseid"):
            raise ValueError("it is no RAWX file: it must have a network with caseid")
        for section, table in network.items():
            names, data = (table.get(name) if isinstance(table, dict) else None for name in ("fields", "data"))
            if not isinstance(names, list) or not isinstance(data, list):
                raise ValueError(f"its {section} data must have the lists fields and data")
            # A section of one record may be that record.
            data = data if not data or isinstance(data[0], list) else [data]
            if not all(isinstance(row, list) for row in data) or not all(isinstance(name, str) for name in names):
                raise ValueError(f"its {section} data must be lists, and their fields names")
            rows = [dict(zip(names, row, strict=False)) for row in data]
            for row in rows:
                record = {name: "" if value is None else str(value).strip() for name, value in row.items()}
                if changed := self._keep(section, record):
                    steps = [name for name in row if re.fullmatch(r"[snb]\d", name)]
                    row |= dict.fromkeys(steps, 0) | changed
            if section in ("load", "swshunt") and rows:
                network[section] = {"fields": list(rows[0]), "data": [list(row.values()) for row in rows]}
        caseid = (self.records["caseid"] or [{}])[0]
        self.version, self.frequency_hz = float(caseid["rev"]), _number(caseid, "basfrq")
        return json.dumps({"network": network})

    def _read_lines(self, text: str) -> str:
        lines = text.splitlines()
        starts = [place for place, line in enumerate(lines) if not line.startswith("@!")]
        header = _fields(lines[starts[0]]) if starts else []
        try:
            self.version = float(header[2])
        except (IndexError, ValueError) as error:
            raise ValueError("it is no RAW file: its first line must have three numbers or more") from error
        if int(self.version) not in (32, 33, 35):
            raise ValueError(f"it cannot be read as RAW of version {self.version:g}; allowed: 32, 33, 35")
        self.frequency_hz = _number(dict(enumerate(header)), 5)
        new = self.version >= 34
        queue = iter(_SECTIONS_35 if new else _SECTIONS)
        section, written = next(queue), lines[: starts[2] + 1] if len(starts) > 2 else lines
        rest = 0  # of the lines of a transformer
        for line in lines[len(written) :]:
            if line.startswith("@!"):
                continue
            if re.match(r"\s*Q\s*$", line):
                break
            if section == "acline" and not new:
                # The sign of a bus tells the metered end.
                line = re.sub(r"^(\s*\d+[\s,]+)-", r"\1", line)
            if re.match(r"\s*0\s*($|/|[A-Za-z])", line):
                section, rest = next(queue, ""), 0
            elif rest:
                rest -= 1
            elif fields := _fields(line):
                skipped = () if new else _NEW.get(section, ())
                names = [name for name in _FIELDS.get(section, "name").split() if name not in skipped]
                record = dict(zip(names, fields, strict=False))
                if section == "transformer":
                    rest = 3 if record.get("kbus", "0") in ("", "0") else 4
                if changed := self._keep(section, record):
                    record |= {name: f"{value:.12g}" for name, value in changed.items()}
                    texts = [record.get(name, "") for name in names]
                    line = ",".join(each if re.fullmatch(r"[^A-Za-z ]+", each) else f"'{each}'" for each in texts)
            written.append(line)
        else:
            if section not in _LAST or (section and self.records[section]):
                raise ValueError(f"it ends within its {section} data")
        return "\n".join([*written, "Q", ""])

    def _keep(self, section: str, record: dict[str, str]) -> dict[str, float]:
        """Keep a record, which is there once; return what pypowsybl should read in it instead."""
        key = {name: record.get(name, "") for name in _FIELDS.get(section, "").split()[: _KEYS.get(section, 0)]}
        # A branch may be written from either end, and its metered one negative.
        buses = sorted(value.lstrip("-0") for name, value in key.items() if name.endswith("bus"))
        ids = [value or "1" for name, value in key.items() if not name.endswith("bus")]
        which = " ".join(["-".join(filter(None, buses)), *ids])
        if key and (section, which) in self._seen:
            raise ValueError(f"its {section} data have more than one record of bus {which}")
        self._seen.add((section, which))
        self.records[section].append(record)
        if section == "bus" and record.get("ide", "") not in _TYPES:
            what = f"bus {record['ibus']} is of type {record['ide']!r:.40}"
            raise ValueError(f"{what}; allowed: 1, 2, 3, 4 (a name with blanks needs quotes)")
        if section == "load" and (reactive := _number(record, "yq")):
            # Of an admittance: negative for an inductive load, where pypowsybl takes power.
            return {"yq": -reactive}
        if section != "swshunt":
            return {}
        # The initial susceptance is the only step.
        initial = _number(record, "binit")
        return {"s1": 1, "n1": 1, "b1": initial} if initial else {"stat": 0}

    def _check_buses(self) -> None:
        """Refuse what pypowsybl leaves out: records at buses that are not there, and branches from a bus to itself."""
        there = {row.get("ibus", "").lstrip("0") for row in self.records["bus"]}
        for section, count in _KEYS.items():
            names = [name for name in _FIELDS[section].split()[:count] if name.endswith("bus")]
            for row in self.records[section]:
                ends = [row.get(name, "").lstrip("0") for name in names]
                # A transformer of two windings has no third bus.
                ends = [end for place, end in enumerate(ends) if end or place < 2]
                its = f"as RAW of version {self.version:g}, its {section} data"
                if unknown := [end for end in ends if end not in there]:
                    raise ValueError(f"{its} name the bus {unknown[0] or 0}, which is not there")
                if len(set(ends)) < len(ends):
                    raise ValueError(f"{its} have a branch from bus {max(ends, key=ends.count)} to itself")

    def passed_over(self) -> Iterator[tuple[str, int]]:
        """Yield what pypowsybl passes over: type and number."""
        for section, kind in _PASSED_OVER.items():
            yield kind, len({next(iter(record.values()), "") for record in self.records[section]})
        yield "distributed-generation", sum(record.get("dgenm") == "1" for record in self.records["load"])
        yield "facts-series", sum(record.get("jbus", "0") not in ("0", "") for record in self.records["facts"])

    def machines(self) -> dict[tuple[str, str], dict[str, float]]:
        """Return rating [MVA], source impedance [p.u.] and kind of wind machine by bus and id."""
        return {
            (row["ibus"], row.get("machid", "1")): {name: _number(row, name, value) for name, value in _MACHINE.items()}
            for row in self.records["generator"]
        }


def _fields(line: str) -> list[str]:
    """Return the fields of a record, which commas or blanks part; a slash begins a remark, '' in a text is a quote."""
    fields, empty = list[str](), True
    for token in re.findall(r"""'(?:[^']|'')*'|"[^"]*"|[^\s,'"/]+|[,/]""", line):
        if token == "/":
            break
        if token != ",":
            fields.append(token.strip("'\" "))
            empty = False
        elif empty:
            fields.append("")
        else:
            empty = True
    return fields


def _number(record: Mapping[Any, str], name: Any, default: float = 0.0) -> float:
    text = record.get(name) or str(default)
    try:
        # Fortran's exponents.
        return float(text.upper().replace("D", "E"))
    except ValueError as error:
        raise ValueError(f"a record has {text!r} for {name}, which is no number") from error


class _Tables:
    """A network of pypowsybl, solved, whose tables become a case."""

    def __init__(self, library: Any, net: Any, name: str, raw: _Raw | None, notes: list[str]) -> None:
        self.net, self.name, self.raw, self.notes = net, name, raw, notes
        self.bus_of = _buses(net)
        # The least where several are one bus.
        self.numbers: dict[Any, int] = {key: number for number, key in sorted(self.bus_of.items(), reverse=True)}
        self.slack = self._slack()
        self._solve(library)
        levels = net.get_voltage_levels()["nominal_v"]
        self.buses = net.get_buses()
        self.volts = {key: float(levels[level]) for key, level in self.buses["voltage_level_id"].items()}

    def _slack(self) -> str:
        slacks = sorted(set(self.net.get_extensions("slackTerminal").get("bus_id", [])) - {"", None})
        if len(slacks) > 1:
            raise ValueError(f"the case must have one slack bus, got {[self.numbers.get(key, key) for key in slacks]}")
        if slacks:
            return str(slacks[0])
        generators = self.net.get_generators()
        able = generators[generators["connected"] & generators["voltage_regulator_on"]]
        if able.empty:
            raise ValueError("no generator in service holds a voltage")
        bus = str(able.loc[able["max_p"].idxmax(), "bus_id"])
        self.notes.append(solved_case.NO_SLACK.format(self.numbers.get(bus, bus)))
        return bus

    def _solve(self, library: Any) -> None:
        provider = {**_OF_PROVIDER, "slackBusSelectionMode": "NAME", "slackBusesIds": self.slack}
        statuses = []
        for start in ("UNIFORM_VALUES", "DC_VALUES", "PREVIOUS_VALUES"):
            mode = library.loadflow.VoltageInitMode.__members__[start]
            flow = library.loadflow.Parameters(voltage_init_mode=mode, provider_parameters=provider, **_FLOW)
            try:
                results = library.loadflow.run_ac(self.net, flow)
            except Exception as error:
                statuses.append(f"{error}")
                continue
            statuses += [result.status_text for result in results[:1]]
            if results and results[0].status_text == "Converged":
                # Power that the slack bus gives beside what the case says of its generators [MW].
                self.missing_mw = float(results[0].slack_bus_results[0].active_power_mismatch)
                return
        raise ValueError(f"pypowsybl finds no power flow: {', '.join(dict.fromkeys(statuses))}")

    def case(self, frequency_hz: float | None) -> solved_case.SolvedCase:
        """Return the case."""
        part = self.buses.loc[self.slack, "synchronous_component"]
        frequency = frequency_hz or (self.raw.frequency_hz if self.raw is not None else 0.0)
        if not frequency:
            frequency = 60.0 if self.net.source_format in ("IEEE-CDF", "PSS/E") else 50.0
            self.notes.append(f"the nominal frequency is taken as {frequency:g} Hz, which the file does not say")
        voltages = dict.fromkeys(self.buses.index, 0j)
        for key, row in self.buses[self.buses["synchronous_component"] == part].iterrows():
            voltages[key] = cmath.rect(row.v_mag / self.volts[key], math.radians(row.v_angle))
        self.out = solved_case.SolvedCase(self.name, "pypowsybl", frequency, self.slack, voltages)
        self.out.numbers, self.out.notes, self.out.load_mw = dict(self.numbers), self.notes, self._load_mw()
        if self.raw is not None:
            self._compare_stored(self.raw)
        self._add_branches()
        self._add_injections()
        self._add_generators()
        return self.out

    def _load_mw(self) -> float:
        """Return the load of the solution: what generators give beyond losses and shunts, and what boundaries take."""
        total_mw = self.missing_mw
        for name in _AT_BUSES:
            table = getattr(self.net, f"get_{name}")() if name != "loads" else {}
            total_mw -= sum(float(table[p].sum()) for p in ("p", "p1", "p2", "p3") if p in table)
        ends = self.net.get_boundary_lines(all_attributes=True)
        ends = ends[ends["connected"]]
        return total_mw - float(ends["p"].sum() - ends["p0"][ends["tie_line_id"] == ""].sum())

    def _compare_stored(self, raw: "_Raw") -> None:
        """Note how far the solution is from the voltages that a RAW file stores, unless those are a flat start."""
        rows = {int(row["ibus"]): row for row in raw.records["bus"]}
        stored = {n: cmath.rect(_number(row, "vm", 1.0), math.radians(_number(row, "va"))) for n, row in rows.items()}
        turn = cmath.phase(stored.get(self.numbers.get(self.slack, 0), 1 + 0j))
        far = {
            number: abs(here - there * cmath.exp(-1j * turn))
            for number, there in stored.items()
            if (here := self.out.voltages.get(self.bus_of.get(number, ""), 0j))
        }
        if far and set(stored.values()) != {1 + 0j}:
            bus = max(far, key=far.__getitem__)
            what = "largest difference from the voltages that the file stores, as phasors"
            self.notes.append(f"{what}: {far[bus]:.2g} p.u. at bus {bus}")

    def _add_branch(
        self, name: str, ends: tuple[Any, Any], ohms: complex, siemens: tuple[complex, complex], ratio: complex = 1.0
    ) -> None:
        """Add a branch: impedance and shunts [Ω, S] behind an ideal transformer, where V_1 · ratio is."""
        one, other = ends
        if not one and not other:
            return
        if not one or not other:
            # The open end leaves the shunt there behind the impedance.
            near, far = siemens if one else siemens[::-1]
            shunt = (near + far / (1.0 + ohms * far)) * (abs(ratio) ** 2 if one else 1.0)
            self.out.shunts[one or other] += shunt * self.volts[one or other] ** 2 / solved_case.BASE_MVA
            return
        base = self.volts[other] ** 2 / solved_case.BASE_MVA
        tap = self.volts[other] / (self.volts[one] * ratio)
        shunts, title = (siemens[0] * base, siemens[1] * base), " ".join(name.split())
        self.out.branches.append(solved_case.TwoPort(title, ends, ohms / base, shunts, abs(tap), cmath.phase(tap)))

    def _add_branches(self) -> None:
        for name, row in self.net.get_lines().iterrows():
            ends = row.bus1_id if row.connected1 else "", row.bus2_id if row.connected2 else ""
            shunts = complex(row.g1, row.b1), complex(row.g2, row.b2)
            self._add_branch(str(name), ends, complex(row.r, row.x), shunts)
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
        # Lines to boundaries, which a tie line joins, and where one ends what it carries is a load.
        for name, row in self.net.get_boundary_lines(all_attributes=True).iterrows():
            if not row.connected:
                continue
            key = f"boundary of {row.tie_line_id or name}"
            # The halves of a tie line may have other nominal voltages.
            self.volts.setdefault(key, self.volts[row.bus_id])
            self.out.voltages.setdefault(key, complex(math.nan, 0.0))
            half = complex(row.g, row.b)
            self._add_branch(str(name), (row.bus_id, key), complex(row.r, row.x), (half, 0j))
            if not row.tie_line_id:
                self.out.loads[key] += complex(row.p0, row.q0)

    def _add_injections(self) -> None:
        loads, shunts = self.net.get_loads(), self.net.get_shunt_compensators()
        for _, row in loads[loads["connected"] & (loads["bus_id"] != "")].iterrows():
            name = f"bus {self.numbers.get(row.bus_id, row.bus_id)}"
            self.out.add_load(row.bus_id, name, complex(row.p0, row.q0), complex(row.p, row.q))
        for key, row in self.buses.iterrows():
            self.out.loads[key] += complex(row.get("fictitious_p0", 0.0), row.get("fictitious_q0", 0.0))
        for _, row in shunts[shunts["connected"] & (shunts["bus_id"] != "")].iterrows():
            self.out.shunts[row.bus_id] += complex(row.g, row.b) * self.volts[row.bus_id] ** 2 / solved_case.BASE_MVA

    def _add_generators(self) -> None:
        machines = self.net.get_generators(all_attributes=True)
        of_raw = {} if self.raw is None else self.raw.machines()
        for role, table in (("machine", machines), ("static", self.net.get_batteries())):
            for name, row in table[table["connected"] & (table["bus_id"] != "")].iterrows():
                of_name = re.fullmatch(r"B(\d+)-G(.*)", str(name))
                place = (of_name[1], of_name[2].strip('" ')) if of_name else ("", "1")
                data = of_raw.get(place, _MACHINE)
                source = "WIND" if data["wmod"] else row.get("energy_source", "")
                limits = row.max_q, row.max_p if row.bus_id == self.slack else 0.0
                rated = float(row.get("rated_s", math.nan))
                taken = complex(row.p, row.q)
                power = -taken if cmath.isfinite(taken) else complex(row.target_p, row.target_q)
                infeed = solved_case.Infeed(name=str(name), bus=row.bus_id, power=power, machine_id=place[1])
                infeed.role = {"WIND": "wind", "SOLAR": "static"}.get(source, role)
                infeed.rating_mva = data["mbase"] or (rated if 0.0 < rated < solved_case.UNLIMITED else None)
                infeed.impedance = complex(data["zr"], data["zx"])
                infeed.limits_mvar = float(row.get("min_q_at_p", math.nan)), float(row.get("max_q_at_p", math.nan))
                infeed.least_mva = max([float(v) for v in limits if v < solved_case.UNLIMITED], default=0.0)
                self.out.infeeds.append(infeed)
        slack = [each for each in self.out.infeeds if each.bus == self.slack and each.role == "machine"]
        for each in slack:
            each.power += self.missing_mw / len(slack)
