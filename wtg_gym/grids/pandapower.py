"""Networks of pandapower (https://www.pandapower.org), as the tables that :mod:`wtg_gym.grids.andes` reads.

pandapower has no dynamics: every generator and external grid becomes a typical machine.
"""

from __future__ import annotations

import io
import json
import math
import re
import warnings
from pathlib import Path
from typing import Any

from wtg_gym.extras import install_advice
from wtg_gym.files import parse_json, read_text
from wtg_gym.grids.andes import Row, Tables
from wtg_gym.physics.grid import MOST_BUSES
from wtg_gym.ranges import require_count

#: What every file of a network says before its tables.
_MARK, _MARK_WITHIN = "pandapowerNet", 300
#: In place of a network's own base, which is 1 MVA as a rule.
_BASE_MVA = 100.0
#: The first version that does not run code which a file brings along.
_OLDEST = (3, 5, 4)
#: Module and class of what a network consists of.
_CLASSES = {
    ("pandapower.auxiliary", "pandapowerNet"),
    *((module, "DataFrame") for module in ("pandas", "pandas.core.frame")),
    *((module, "Series") for module in ("pandas", "pandas.core.series")),
    ("numpy", "array"),
}


def is_network(path: Path) -> bool:
    """Return whether a file holds a network of pandapower, as `pandapower.to_json` writes it."""
    if not path.is_file():
        raise ValueError(f"there is no file {path}")
    with path.open(errors="replace") as file:
        return _MARK in file.read(_MARK_WITHIN)


def tables_of(path: Path) -> Tables:
    """Return the tables of a network's file, with its solved power flow; a bus has pandapower's index plus one.

    Raises:
        ValueError: pandapower is not installed or too old, cannot read the file, or finds no power flow.
    """
    net = _solved_network(path)
    from pandapower.pypower import idx_brch, idx_bus, idx_gen

    solved = net._ppc
    base, own = _BASE_MVA, net._pd2ppc_lookups["bus"]
    # Closed switches make one bus of several, open ones at the end of a line add one.
    numbers = {int(own[index]): int(index) + 1 for index in sorted(net.bus.index, reverse=True) if own[index] >= 0}
    for bus in range(len(solved["bus"])):
        numbers.setdefault(bus, max(numbers.values()) + 1)
    rows: dict[str, list[Row]] = {name: [] for name in ("Bus", "PQ", "PV", "Slack", "Shunt", "Line")}
    for bus in solved["bus"].real:
        index = numbers[int(bus[idx_bus.BUS_I])]
        x, y = _place(net.bus.geo.get(index - 1))
        rows["Bus"].append({"idx": index, "Vn": bus[idx_bus.BASE_KV], "xcoord": x, "ycoord": y})
        rows["PQ"].append({"bus": index, "p0": bus[idx_bus.PD] / base, "q0": bus[idx_bus.QD] / base})
        shunt = {"g": bus[idx_bus.GS] / base, "b": bus[idx_bus.BS] / base}
        rows["Shunt"].append({"bus": index, "Sn": base, "Vn": bus[idx_bus.BASE_KV], **shunt})
    volts = {row["idx"]: row["Vn"] for row in rows["Bus"]}
    slack = {int(bus[idx_bus.BUS_I]) for bus in solved["bus"].real if bus[idx_bus.BUS_TYPE] == idx_bus.REF}
    for place, gen in enumerate(row for row in solved["gen"].real if row[idx_gen.GEN_STATUS] > 0.0):
        bus = int(gen[idx_gen.GEN_BUS])
        power = {"p0": gen[idx_gen.PG] / base, "q0": gen[idx_gen.QG] / base}
        source = {"idx": place, "bus": numbers[bus], "v0": gen[idx_gen.VG], "Sn": base, **power}
        rows["Slack" if bus in slack else "PV"].append(source)
    for branch in solved["branch"].real:
        ends = [numbers[int(branch[end])] for end in (idx_brch.F_BUS, idx_brch.T_BUS)]
        values = {"r": branch[idx_brch.BR_R], "x": branch[idx_brch.BR_X], "b": branch[idx_brch.BR_B]}
        rows["Line"].append({
            "u": branch[idx_brch.BR_STATUS], "bus1": ends[0], "bus2": ends[1], "Sn": base, "Vn1": volts[ends[0]],
            "tap": branch[idx_brch.TAP], "phi": math.radians(branch[idx_brch.SHIFT]), "g": branch[idx_brch.BR_G],
            **values, **dict.fromkeys(("g1", "b1", "g2", "b2"), 0.0),
        })  # fmt: skip
    system = {"mva": base, "freq": float(net.f_hz)}
    return {**rows, "_config": [{"section": "System", "key": key, "value": value} for key, value in system.items()]}


def _solved_network(path: Path) -> Any:
    """Return pandapower's network of a file with its power flow; errors as of :func:`tables_of`."""
    try:
        import pandapower
    except ImportError as error:
        raise ValueError(f"it needs pandapower; {install_advice('pandapower')}") from error
    if tuple(map(int, re.findall(r"\d+", pandapower.__version__)[:3])) < _OLDEST:
        oldest = ".".join(map(str, _OLDEST))
        raise ValueError(
            f"pandapower {pandapower.__version__} runs code that a file names; {oldest} or later is needed: "
            f"{install_advice('pandapower')}"
        )
    text = read_text(path, "network of pandapower")
    _check_classes(parse_json(text, "it"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        # Errors of pandapower are of any kind.
        try:
            net = pandapower.from_json(io.StringIO(text))
            require_count("the table of buses", len(net.bus), MOST_BUSES)
            net.sn_mva = _BASE_MVA
        except Exception as error:
            raise ValueError(f"pandapower cannot read it: {type(error).__name__}: {error}") from error
        try:
            # The shifts of vector groups are the same along every path between two voltages.
            pandapower.runpp(net, calculate_voltage_angles=False, numba=False)
        except Exception as error:
            raise ValueError(f"pandapower finds no power flow: {error}") from error
    return net


def _check_classes(data: Any) -> None:
    """Refuse every class but those of tables, because pandapower imports the module that a file names.

    A table is a text of JSON in the file, whose cells may name classes too.
    """
    if isinstance(data, dict):
        if "_module" in data:
            module, name = data["_module"], data.get("_class")
            if (module, name) not in _CLASSES:
                raise ValueError(f"it names the class {name!r:.80} of module {module!r:.80}; only tables are read")
            if isinstance(data.get("_object"), str):
                _check_classes(parse_json(data["_object"], "a table of it"))
        data = list(data.values())
    if isinstance(data, list):
        for each in data:
            _check_classes(each)


def _place(geo: Any) -> tuple[float | None, float | None]:
    """Return where a bus is, of its GeoJSON."""
    if not isinstance(geo, str) or not geo:
        return None, None
    x, y, *_ = json.loads(geo)["coordinates"]
    return float(x), float(y)
