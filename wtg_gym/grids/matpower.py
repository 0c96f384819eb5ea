"""Tables of MATPOWER's form, from its own files and from networks of pandapower, as a solved case.

A .m file is solved by PYPOWER, a network of pandapower by pandapower. pypowsybl reads
MATPOWER's binary form too, but takes a bus of type 4 as in service, lets a generator at a bus of type 1 hold its
voltage, and puts all charging of a transformer at one end; its converter from pandapower is up to 0.007 p.u. off.
"""

import io
import json
import math
import re
import warnings
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat
from scipy.io.matlab import MatReadError

from wtg_gym.extras import install_advice
from wtg_gym.files import parse_json, read_text
from wtg_gym.grids import solved_case
from wtg_gym.ranges import require_range

#: What every file of a network of pandapower says before its tables.
_MARK, _MARK_WITHIN = "pandapowerNet", 300
#: The first version of pandapower that does not run code which a file brings along.
_OLDEST = (3, 5, 4)
#: Module and class of what a network consists of.
_CLASSES = {
    ("pandapower.auxiliary", "pandapowerNet"),
    *((module, "DataFrame") for module in ("pandas", "pandas.core.frame")),
    *((module, "Series") for module in ("pandas", "pandas.core.series")),
    ("numpy", "array"),
}
#: Tables of pandapower that its own power flow turns into MATPOWER's without loss.
_READ = (
    "bus load sgen motor asymmetric_load asymmetric_sgen storage gen ext_grid shunt ward line trafo trafo3w impedance "
    "switch"
)
#: Tables of a .m file that say nothing about the power flow.
_SILENT = "version baseMVA bus gen branch gencost bus_name branch_name gen_name genfuel gentype areas"
_SAVE = "save the case there as a .mat file or by savecase"
#: A number or a text of any name, and what is the base.
_SCALAR = r"(?m)mpc\.(version|baseMVA|\w+(?=\s*=\s*(?:[-+.\deE]+|'[^'\n]*')\s*(?:;|$)))\s*=\s*([^;\n]+);?"
#: Columns of MATPOWER's tables, and those that pandapower adds to the branches.
_BUS, _TYPE, _PD, _QD, _GS, _BS, _VM, _VA = 0, 1, 2, 3, 4, 5, 7, 8
_GEN, _PG, _QG, _QMAX, _QMIN, _GEN_STATUS, _PMAX = 0, 1, 2, 3, 4, 7, 8
_FROM, _TO, _R, _X, _B, _TAP, _SHIFT, _STATUS = 0, 1, 2, 3, 4, 8, 9, 10
_PF, _QF, _PT, _QT = 13, 14, 15, 16
_R_ASYM, _X_ASYM, _G, _G_ASYM, _B_ASYM = 21, 22, 23, 24, 25
_HELD, _REFERENCE, _ISOLATED = 2, 3, 4
#: Of each table: its least number of columns, its numbers of buses, and where neither Inf nor NaN may stand.
_NEEDED = {
    "bus": (9, [_BUS], (_TYPE, _PD, _QD, _GS, _BS, _VM, _VA)),
    "gen": (9, [_GEN], (_PG, _QG, 5, _GEN_STATUS)),
    "branch": (11, [_FROM, _TO], (_R, _X, _B, _TAP, _SHIFT, _STATUS)),
}


def is_network(path: Path) -> bool:
    """Return whether a file holds a network of pandapower, as `pandapower.to_json` writes it."""
    with path.open(errors="replace") as file:
        return _MARK in file.read(_MARK_WITHIN)


def read_matpower(path: Path, frequency_hz: float | None, drop: Collection[str]) -> solved_case.SolvedCase:
    """Return the case of a .m or .mat file, as PYPOWER solves it; a ValueError says why it is none."""
    from pypower.api import ppoption, runpf

    if path.suffix.lower() == ".mat":
        try:
            data = loadmat(path, simplify_cells=True)["mpc"]
        # A file of version 7.3 is HDF5.
        except (MatReadError, NotImplementedError) as error:
            raise ValueError(f"it is no .mat file: {error}") from error
        fuels = dict(enumerate(map(str, np.ravel(data.get("genfuel", []))), start=1))
    else:
        data, fuels = _written_tables(read_text(path, "case", or_latin=True))
    base_mva = _matrix("baseMVA", [[data["baseMVA"]]])[0, 0]
    require_range("its baseMVA", base_mva, 0.1, 1e5, "MVA")
    tables = {name: _matrix(f"table {name}", data[name]) for name in ("bus", "gen", "branch")}
    notes: list[str] = []
    unknown = {name: value for name, value in data.items() if name not in _SILENT.split()}
    if scalars := [name for name, value in unknown.items() if isinstance(value, (str, int, float, np.number))]:
        notes.append(f"scalars that say nothing about the power flow are passed over: {', '.join(scalars)}")
    more = {
        name: (len(value) if isinstance(value, list) else np.size(value) and len(np.atleast_2d(value)), 0.0)
        for name, value in unknown.items()
        if name not in scalars
    }
    if more.get("dcline", (0,))[0]:
        lines = _matrix("table dcline", data["dcline"])
        if lines.shape[1] < 4:
            raise ValueError(f"its table dcline has {lines.shape[1]} columns; allowed: 4 or more")
        more["dcline"] = int(lines[:, 2].sum()), float((lines[:, 2] * abs(lines[:, 3])).sum())
    solved_case.refuse_unread(more, drop, notes)
    solved_case.refuse_large(len(tables["bus"]))
    _check(tables)
    if fuels and len(fuels) != len(tables["gen"]):
        raise ValueError(f"its genfuel names {len(fuels)} generators, its table gen {len(tables['gen'])}")
    _set_slack(tables, notes)
    for name, columns in (("bus", 13), ("gen", 21), ("branch", 13)):
        # Limits may be infinite or none.
        rows = np.nan_to_num(tables[name], posinf=solved_case.UNLIMITED, neginf=-solved_case.UNLIMITED)
        tables[name] = np.pad(rows, ((0, 0), (0, max(columns - rows.shape[1], 0))))
    unsolved = {"version": "2", "baseMVA": base_mva, **tables}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        # Rounding may keep a large case from the narrower tolerance.
        for tolerance in (1e-11, 1e-9):
            solved, converged = runpf(unsolved, ppoption(VERBOSE=0, OUT_ALL=0, PF_TOL=tolerance))
            if converged:
                break
    if not converged:
        raise ValueError("PYPOWER finds no power flow")
    if frequency_hz is None:
        notes.append("the nominal frequency is taken as 60 Hz, which a MATPOWER case does not say (--frequency)")
    numbers = {int(number): int(number) for number in solved["bus"][:, _BUS]}
    case = _case_of(solved, path.stem, "PYPOWER", frequency_hz or 60.0, numbers, notes)
    roles = dict.fromkeys(("wind", "WT", "W"), "wind") | dict.fromkeys(("solar", "PV"), "static")
    for infeed in case.infeeds:
        infeed.role = roles.get(fuels.get(int(infeed.machine_id), ""), "machine")
    return case


def _matrix(name: str, rows: Any) -> Any:
    rows = rows if isinstance(rows, list) else np.atleast_2d(rows)
    if not np.size(rows[:1]):
        raise ValueError(f"its {name} is empty")
    for place, row in enumerate(rows, start=1):
        for value in row:
            try:
                float(value)
            except (TypeError, ValueError) as error:
                what = f"its {name} has {value!r} in row {place}, which is no number"
                raise ValueError(f"{what}; if MATLAB reads it, {_SAVE}") from error
        if len(row) != len(rows[0]):
            raise ValueError(f"row {place} of its {name} has {len(row)} numbers, the first one {len(rows[0])}")
    return np.array(rows, dtype=float)


def _check(tables: Mapping[str, Any]) -> None:
    """Refuse by its place what no case has: numbers that are none, where no limit is meant, and buses that are none."""
    counts = Counter(tables["bus"][:, _BUS].tolist())
    for name, (least, ends, needed) in _NEEDED.items():
        if (columns := tables[name].shape[1]) < least:
            raise ValueError(f"its table {name} has {columns} columns; allowed: {least} or more")
        for place, row in enumerate(tables[name], start=1):
            at = f"row {place} of its table {name}"
            for column in needed:
                if not math.isfinite(row[column]):
                    raise ValueError(f"{at} has {row[column]:g} in column {column + 1}, which must be finite")
            for bus in row[ends]:
                if not 1.0 <= bus < 2**31 or bus % 1.0:
                    raise ValueError(f"{at} has the bus number {bus:.10g}; allowed: whole numbers from 1")
                if counts[bus] != 1:
                    problem = "there twice" if counts[bus] else "not there"
                    raise ValueError(f"{at} names bus {bus:g}, which is {problem}")
            if name == "bus" and row[_TYPE] not in (1, 2, 3, 4):
                raise ValueError(f"bus {row[_BUS]:g} is of type {row[_TYPE]:g}; allowed: 1, 2, 3, 4")
            if name == "branch" and row[_STATUS] not in (0, 1):
                raise ValueError(f"{at} has the status {row[_STATUS]:g}; allowed: 0, 1")
    off = tables["bus"][tables["bus"][:, _TYPE] == _ISOLATED, _BUS]
    if not ((tables["gen"][:, _GEN_STATUS] > 0.0) & ~np.isin(tables["gen"][:, _GEN], off)).any():
        raise ValueError("no generator is in service")


def _set_slack(tables: Mapping[str, Any], notes: list[str]) -> None:
    """Make the bus of the largest generator the slack where the case has none, as for other formats."""
    bus, gen = tables["bus"], tables["gen"]
    held = bus[bus[:, _TYPE] == _HELD, _BUS]
    able = gen[(gen[:, _GEN_STATUS] > 0.0) & np.isin(gen[:, _GEN], held)]
    if _REFERENCE not in bus[:, _TYPE] and len(able):
        largest = able[np.argmax(able[:, _PMAX]), _GEN]
        bus[bus[:, _BUS] == largest, _TYPE] = _REFERENCE
        notes.append(solved_case.NO_SLACK.format(f"{largest:g}"))


def _written_tables(text: str) -> tuple[dict[str, Any], dict[int, str]]:
    """Return what a .m file says by name, and the fuels of its generators from 1 on; statements are refused."""
    text = re.sub(r"(?ms)^[ \t]*%\{[ \t]*$.*?^[ \t]*%\}[ \t]*$", "", "\n".join([*text.splitlines(), ""]))
    # Within quotes begins neither a comment nor a continuation.
    text = re.sub(r"('[^'\n]*')|%.*|\.\.\..*\n", r"\1 ", text)
    genfuel = re.search(r"mpc\.genfuel\s*=\s*\{(.*?)\}", text, re.DOTALL)
    fuels = dict(enumerate(re.findall(r"'([^']*)'", genfuel[1]), start=1)) if genfuel else {}
    tables = re.findall(r"mpc\.(\w+)\s*=\s*\[(.*?)\]", text, re.DOTALL)
    scalars = re.findall(_SCALAR, text)
    left = re.sub(r"(?s)mpc\.\w+\s*=\s*(?:\[.*?\]|\{.*?\})\s*;?", "", text)
    left = re.sub(_SCALAR, "", left)
    left = re.sub(r"(?m)function\s+[^\n]*|^\s*(?:end|return)\s*;?\s*$", "", left)
    if statements := [line.strip() for line in left.splitlines() if line.strip(" ;\t\r")]:
        what = f"besides its tables it has statements, such as {statements[0]!r:.80}"
        raise ValueError(f"{what}, which only MATLAB or Octave can run: {_SAVE}")
    names = [name for name, _ in (*tables, *scalars)]
    if len(set(names)) < len(names) or not {"bus", "gen", "branch", "baseMVA"} <= set(names):
        raise ValueError(f"it must have baseMVA and the tables bus, gen and branch, and each once, got {names}")
    rows = {name: [row.replace(",", " ").split() for row in re.split(r"[;\n]", body)] for name, body in tables}
    return {**dict(scalars), **{name: [row for row in body if row] for name, body in rows.items()}}, fuels


def read_pandapower(path: Path, frequency_hz: float | None, drop: Collection[str]) -> solved_case.SolvedCase:
    """Return the case of a network's file, as pandapower solves it; a bus has pandapower's index plus one.

    A ValueError says that pandapower is too old, cannot read the file, or finds no power flow.
    """
    notes: list[str] = []
    net = _solved_network(path, drop, notes)
    tables, place_of = net._ppc, net._pd2ppc_lookups["bus"]
    # Closed switches make one bus of several, open ones at the end of a line add one.
    numbers = {int(place_of[bus]): int(bus) + 1 for bus in sorted(net.bus.index, reverse=True) if place_of[bus] >= 0}
    for bus in range(len(tables["bus"])):
        numbers.setdefault(bus, max(*numbers.values(), int(net.bus.index.max()) + 1) + 1)
    solved = {name: tables[name].real.copy() for name in ("bus", "gen", "branch")} | {"baseMVA": tables["baseMVA"]}
    # The first of several external grids is the slack: each has what the solution gives it.
    others = np.flatnonzero(solved["bus"][:, _TYPE] == _REFERENCE)[1:]
    solved["bus"][others, _TYPE] = _HELD
    if others.size:
        what = ", ".join(str(numbers[int(bus)]) for bus in solved["bus"][others, _BUS])
        notes.append(f"external grids beside the first are machines: at buses {what}")
    for index, row in net.storage[net.storage.in_service].iterrows():
        notes.append(f"storage {index} at bus {row.bus + 1} is a load of {net.res_storage.p_mw[index]:.6g} MW")
    case = _case_of(solved, path.stem, "pandapower", frequency_hz or float(net.f_hz), numbers, notes)
    for index, row in net.sgen[net.sgen.in_service].iterrows():
        bus, power = int(place_of[row.bus]), complex(*net.res_sgen.loc[index, ["p_mw", "q_mvar"]])
        if bus in case.voltages and power:
            wind = str(row.type).lower() in ("wp", "wind", "wt") or str(row["name"]).lower().startswith("wind")
            case.loads[bus] += power
            case.load_mw += power.real
            name = f"static generator {index}"
            case.infeeds.append(solved_case.Infeed(name=name, bus=bus, power=power, role="wind" if wind else "static"))
    for bus, number in numbers.items():
        place = net.bus.geo.get(number - 1) if "geo" in net.bus else None
        if isinstance(place, str) and place:
            x, y, *_ = json.loads(place)["coordinates"]
            case.places[bus] = float(x), float(y)
    return case


def _solved_network(path: Path, drop: Collection[str], notes: list[str]) -> Any:
    import pandapower

    version = pandapower.__version__
    if tuple(map(int, re.findall(r"\d+", version)[:3])) < _OLDEST:
        oldest = f"{'.'.join(map(str, _OLDEST))} or later is needed: {install_advice('grids')}"
        raise ValueError(f"pandapower {version} runs code that a file names; {oldest}")
    text = read_text(path, "network of pandapower")
    _check_classes(parse_json(text, "it"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        # Errors of pandapower are of any kind.
        try:
            net = pandapower.from_json(io.StringIO(text))
            net.sn_mva = solved_case.BASE_MVA
        except Exception as error:
            raise ValueError(f"pandapower cannot read it: {type(error).__name__}: {error}") from error
        solved_case.refuse_large(len(net.bus))
        # Elements that have no place in MATPOWER's tables are refused, or put out of service where `drop` says so.
        unread = {}
        for name, table in net.items():
            is_read = name in _READ.split() or name.startswith(("_", "res_"))
            if not is_read and "in_service" in getattr(table, "columns", ()):
                able = table[table.in_service.astype(bool)]
                power = [abs(able[column]).sum() for column in ("p_mw", "ps_mw") if column in able]
                unread[name] = len(able), float(sum(power))
                if name in drop:
                    net[name]["in_service"] = False
        solved_case.refuse_unread(unread, drop, notes)
        try:
            pandapower.runpp(net, calculate_voltage_angles=True, numba=False, tolerance_mva=1e-8)
        except Exception as error:
            raise ValueError(f"pandapower finds no power flow: {error}") from error
    return net


def _check_classes(data: Any) -> None:
    """Refuse every class but those of tables and of their cells: pandapower imports the module that a file names."""
    if isinstance(data, dict):
        if "_module" in data:
            module, name = data["_module"], data.get("_class")
            if (module, name) not in _CLASSES:
                raise ValueError(f"it names the class {name!r:.80} of module {module!r:.80}; only tables are read")
            if isinstance(data.get("_object"), str):
                _check_classes(parse_json(data["_object"], "a table of it"))
        data = list(data.values())
    if isinstance(data, list):
        for value in data:
            _check_classes(value)


def _case_of(
    solved: Any, name: str, library: str, frequency_hz: float, numbers: dict[int, int], notes: list[str]
) -> solved_case.SolvedCase:
    """Return the case of solved tables, whose loads are what the solution takes at each bus."""
    scale = solved_case.BASE_MVA / float(solved["baseMVA"])
    rows = solved["bus"][solved["bus"][:, _TYPE] != _ISOLATED]
    keys = rows[:, _BUS].astype(int).tolist()
    slacks = [key for key, row in zip(keys, rows, strict=True) if row[_TYPE] == _REFERENCE]
    if len(slacks) != 1:
        raise ValueError(f"the case must have one slack bus, got {[numbers[key] for key in slacks]}")
    polar = rows[:, _VM] * np.exp(1j * np.radians(rows[:, _VA]))
    voltages = dict(zip(keys, map(complex, polar), strict=True))
    case = solved_case.SolvedCase(name, library, frequency_hz, slacks[0], voltages)
    case.numbers, case.notes = {key: numbers[key] for key in keys}, notes
    if len(off := solved["bus"][solved["bus"][:, _TYPE] == _ISOLATED]):
        what = solved_case.listed(numbers[int(row[_BUS])] for row in off)
        case.notes.append(solved_case.OFF.format(off[:, _PD].sum(), what))
    taken = _taken(solved)
    case.load_mw = sum(taken[key].real for key in keys)
    for key, row in zip(keys, rows, strict=True):
        case.shunts[key] += complex(row[_GS], row[_BS]) / solved_case.BASE_MVA
        case.add_load(key, f"bus {numbers[key]}", complex(row[_PD], row[_QD]), taken[key])
    for place, row in enumerate(solved["gen"]):
        key = int(row[_GEN])
        if row[_GEN_STATUS] > 0.0 and key in case.voltages:
            least = [row[_QMAX], row[_PMAX] if key == case.slack else 0.0]
            name, power = f"generator {place + 1}", complex(row[_PG], row[_QG])
            infeed = solved_case.Infeed(name=name, bus=key, power=power, machine_id=str(place + 1))
            infeed.limits_mvar = float(row[_QMIN]), float(row[_QMAX])
            infeed.least_mva = max([v for v in least if v < solved_case.UNLIMITED], default=0.0)
            case.infeeds.append(infeed)
    case.branches = [
        _two_port(row, scale, numbers)
        for row in solved["branch"]
        if row[_STATUS] > 0.0 and int(row[_FROM]) in case.voltages and int(row[_TO]) in case.voltages
    ]
    return case


def _taken(solved: Any) -> dict[int, complex]:
    """Return the load of each bus in the solution [MVA]: power of generators minus that into branches and shunts."""
    bus, gen, branch = (solved[name] for name in ("bus", "gen", "branch"))
    on, closed = gen[gen[:, _GEN_STATUS] > 0.0], branch[branch[:, _STATUS] > 0.0]
    taken = dict(zip(bus[:, _BUS].astype(int), -(bus[:, _GS] - 1j * bus[:, _BS]) * bus[:, _VM] ** 2, strict=True))
    for rows, key, p, q, sign in ((on, _GEN, _PG, _QG, 1), (closed, _FROM, _PF, _QF, -1), (closed, _TO, _PT, _QT, -1)):
        for row in rows:
            taken[int(row[key])] += sign * complex(row[p], row[q])
    return taken


def _two_port(row: Sequence[float], scale: float, numbers: dict[int, int]) -> solved_case.TwoPort:
    ends = int(row[_FROM]), int(row[_TO])
    name = f"branch {numbers[ends[0]]}-{numbers[ends[1]]}"
    near = far = complex(0.0, row[_B])
    if len(row) > _B_ASYM:
        if row[_R_ASYM] or row[_X_ASYM]:
            raise ValueError(f"{name} has another impedance from each side")
        near += row[_G]
        far = near + complex(row[_G_ASYM], row[_B_ASYM])
    impedance, shunts = complex(row[_R], row[_X]) * scale, (0.5 * near / scale, 0.5 * far / scale)
    return solved_case.TwoPort(name, ends, impedance, shunts, float(row[_TAP]) or 1.0, math.radians(row[_SHIFT]))
