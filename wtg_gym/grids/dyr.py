"""Dynamic data of PSS/E's DYR files: a table of the models that a machine here has, typical ones in place of others."""

import re
from collections import Counter, defaultdict
from pathlib import Path
from typing import Any

from wtg_gym.files import read_text
from wtg_gym.grids.solved_case import TYPICAL_EXCITER, TYPICAL_GOVERNOR, Infeed, made, typical_machine
from wtg_gym.physics.grid import MODELS
from wtg_gym.physics.machine import saturation_constants
from wtg_gym.physics.machine_parameters import SynchronousMachineParameters, classical_machine
from wtg_gym.ranges import require_range

#: Share of x'' that a leakage reactance has at most, so that the order x'' > x_l holds.
_LEAKAGE = 0.8
#: Largest saturation that is taken: data beyond it are no machine's.
_LARGEST_SATURATION = 10.0
#: Limit where the data say none [p.u.].
_NO_LIMIT = 999.0
_IEEET = "exciter_gain exciter_time_s"
_POINTS = "_switch saturation_voltage_1_pu saturation_1 saturation_voltage_2_pu saturation_2"
#: Numbers of each model in their order in a record; names with _ have none here.
_NUMBERS = {
    "GENROU": "t_d0_transient_s t_d0_subtransient_s t_q0_transient_s t_q0_subtransient_s _h damping_pu x_d x_q "
    "x_d_transient x_q_transient x_subtransient x_leakage saturation_1_0 saturation_1_2",
    "GENSAL": "t_d0_transient_s t_d0_subtransient_s t_q0_subtransient_s _h damping_pu x_d x_q x_d_transient "
    "x_subtransient x_leakage saturation_1_0 saturation_1_2",
    "GENCLS": "_h damping_pu",
    "SEXS": "lead_lag_ratio lag_time_s gain exciter_time_s field_min_pu field_max_pu",
    "IEEET1": f"sensing_time_s regulator_gain regulator_time_s regulator_max_pu regulator_min_pu {_IEEET} "
    f"feedback_gain_s feedback_time_s {_POINTS}",
    "IEEEX1": "sensing_time_s regulator_gain regulator_time_s lag_time_s lead_time_s regulator_max_pu "
    f"regulator_min_pu {_IEEET} feedback_gain_s feedback_time_s {_POINTS}",
    "TGOV1": "droop_pu gate_time_s gate_max_pu gate_min_pu lead_time_s reheat_time_s turbine_damping_pu",
    "HYGOV": "droop_pu temporary_droop_pu reset_time_s filter_time_s gate_time_s gate_rate_limit_pu_s gate_max_pu "
    "gate_min_pu water_time_s turbine_gain turbine_damping_pu no_load_flow_pu",
    "IEEEG1": "_bus_2 _machine_2 _gain lag_time_s lead_time_s valve_time_s opening_rate_pu_s closing_rate_pu_s "
    "gate_max_pu gate_min_pu pass_time_1_s fraction_1 _k2 pass_time_2_s fraction_2 _k4 pass_time_3_s fraction_3 _k6 "
    "pass_time_4_s fraction_4 _k8",
    "IEESGO": "lag_time_s lead_time_s governor_time_s inlet_time_s reheat_time_s crossover_time_s _gain fraction_2 "
    "fraction_3 gate_max_pu gate_min_pu",
    "GAST": "droop_pu valve_time_s turbine_time_s exhaust_time_s load_limit_pu temperature_gain gate_max_pu "
    "gate_min_pu turbine_damping_pu",
    "STAB1": "_gain_over_time washout_time_s _ratio_1 lag_time_1_s _ratio_2 lag_time_2_s signal_limit_pu",
    "IEEEST": "_input _remote_bus filter_a1_s filter_a2_s2 filter_a3_s filter_a4_s2 filter_a5_s filter_a6_s2 "
    "lead_time_1_s lag_time_1_s lead_time_2_s lag_time_2_s washout_gain_s washout_time_s gain signal_max_pu "
    "signal_min_pu voltage_max_pu voltage_min_pu",
}
#: Models that are read as another one.
_READ_AS = {**{name: name for name in _NUMBERS}, "GENROE": "GENROU", "GENSAE": "GENSAL", "TGOV1N": "TGOV1"}
_MACHINES = ("GENROU", "GENSAL", "GENCLS")
#: Beginnings of names of PSS/E's models by what they are; others are left out.
_FAMILIES = {
    "exciter": r"EX|ES|AC|DC|ST\d+[ABC]?$|IEEET|IEEEX|SEXS|SCRX|REXS|URST|BBSEX|CELIN|EMAC|IVOEX|OEX3T|BUDCZT|IEET|UR",
    "governor": r"TGOV|GAST|GGOV|HYGOV|HYG3|IEEEG|IEESGO|WSIEG|WEHGOV|WPIDHY|WSHY|WESGOV|DEGOV|PIDGOV|CRCMGV|W2301|URGS"
    r"|URCSCT|IVOGO|TURCZT|SHAF|BBGOV|LCFB|TWDM",
    "stabiliser": r"STAB|PSS|IEEEST|ST2CUT|STBSVC|PTIST|IEE2ST|BEPSST|IVOST|OSTB|PFQRG",
}


class Dynamics:
    """The records of a DYR file, as machines of infeeds; a ValueError if a record is none.

    `notes` takes what was assumed or replaced; `substitute` puts typical controls in the place of models that are not
    here, or leaves those out, where :meth:`require_known` would refuse them.
    """

    def __init__(self, path: Path, notes: list[str], *, substitute: bool = False) -> None:
        self.notes, self._substitute = notes, substitute
        self._records = defaultdict[tuple[int, str], dict[str, list[float]]](dict)
        self._unknown = Counter[str]()
        lines = read_text(path, "case", or_latin=True).splitlines()
        text = "\n".join(re.sub(r"^\s*(//|!).*", "", line) for line in lines)
        # Text behind the end of a record, on the same line, is a remark.
        for record in re.sub(r"/.*", "/", text).split("/"):
            fields = re.findall(r"'[^']*'|[^\s,]+", record)
            if fields and not fields[0].isdigit():
                self.notes.append(f"a record of the DYR file that is no machine's is left out: {' '.join(fields)[:40]}")
            elif fields:
                try:
                    bus, model, machine, *numbers = fields
                    key, name = (int(bus), machine.strip("' ")), model.strip("' ").upper()
                    values = [float(n.strip("' ").replace("D", "E").replace("d", "e") or 0.0) for n in numbers]
                except ValueError as error:
                    what = f"a record of the DYR file is not `bus 'MODEL' id numbers /`: {' '.join(fields)!r:.80}"
                    raise ValueError(what) from error
                self._records[key][name] = values

    def require_known(self) -> None:
        """Refuse models of the machines made that are not here, unless they may be replaced."""
        if self._unknown and not self._substitute:
            listed = ", ".join(f"{model} ({n})" for model, n in self._unknown.items())
            raise ValueError(
                f"models that are not here: {listed}; --substitute leaves them out, or puts typical ones there"
            )

    def machine(self, number: int, infeed: Infeed, slack: bool) -> SynchronousMachineParameters | None:
        """Return the machine of an infeed, None where the file has none for it."""
        at, records = f"machine {infeed.machine_id} at bus {number}", self._records.get((number, infeed.machine_id), {})
        controls = self._controls(at, records)
        model = next((name for name in records if _READ_AS.get(name) in _MACHINES), None)
        if model is None:
            return None
        values = self._values(at, model, records[model])
        if values["_h"] == 0.0:
            self._unknown[f"{model} with H = 0, an infinite machine"] += 1
            self.notes.append(f"{at}: {model} with H = 0, an infinite machine: a typical one stands in its place")
            return typical_machine(number, infeed.power, infeed.rating_mva or 0.0, slack=slack)
        common = {
            "bus": number,
            "rating_mva": infeed.rating_mva or abs(infeed.power),
            "two_h_s": 2.0 * values.pop("_h"),
            "dispatch_mw": infeed.power.real,
            "resistance": infeed.impedance.real,
        }
        if _READ_AS.get(model) == "GENCLS":
            for control in sorted(controls.keys() - {"governor"}):
                self.notes.append(f"{at} is a constant voltage: its {control} is left out")
                del controls[control]
            values |= {"x_d_transient": infeed.impedance.imag, "x_leakage": 0.0}
            return made(at, classical_machine, **common, **values, **controls)
        if _READ_AS.get(model) == "GENSAL":
            values |= {"x_q_transient": values["x_q"], "t_q0_transient_s": 1.0}
            self.notes.append(f"{at}: {model} is a GENROU with x'_q = x_q")
        if "stabiliser" in controls and "exciter" not in controls:
            del controls["stabiliser"]
            self.notes.append(f"{at} has no exciter: its stabiliser is left out")
        values = self._ordered(at, values)
        return made(at, SynchronousMachineParameters, **{"exciter": None, **common, **values, **controls})

    def _values(self, at: str, model: str, numbers: list[float]) -> dict[str, float]:
        known = _READ_AS[model]
        if model in ("GENROE", "GENSAE"):
            self.notes.append(f"{at}: {model} is read as {known}, whose saturation is quadratic")
        names = _NUMBERS[known].split()
        if len(numbers) < len(names):
            raise ValueError(f"{at}: {model} has {len(numbers)} numbers, not {len(names)}")
        return dict(zip(names, numbers, strict=False))

    def _ordered(self, at: str, values: dict[str, float]) -> dict[str, float]:
        """Return the parameters of a round rotor, with x'' below x', the leakage below x'', and no time of 0 s."""
        least, subtransient = min(values["x_d_transient"], values["x_q_transient"]), values["x_subtransient"]
        if subtransient > least:
            self.notes.append(f"{at}: x'' {subtransient:g} p.u. exceeds x' and is taken as {least:g} p.u.")
            values["x_subtransient"] = subtransient = least
        if values["x_leakage"] >= subtransient:
            what = f"leakage reactance {values['x_leakage']:g} p.u. is not below x''"
            self.notes.append(f"{at}: {what}; {_LEAKAGE:g} x'' stands instead")
            values["x_leakage"] = _LEAKAGE * subtransient
        for name in [name for name in values if name.startswith("t_") and values[name] == 0.0]:
            values[name] = getattr(typical_machine(1), name)
            self.notes.append(f"{at}: {name} is 0 s; {values[name]:g} s, a typical value, stands instead")
        points = (1.0, values["saturation_1_0"]), (1.2, values["saturation_1_2"])
        (_, values["saturation_1_0"]), (_, values["saturation_1_2"]) = self._saturation(at, *points)
        return values

    def _saturation(self, at: str, *points: tuple[float, float]) -> list[tuple[float, float]]:
        """Return two points of a saturation in order, or none where the data are no machine's."""
        first, second = sorted(points)
        try:
            saturation_constants(at, first, second)
            require_range(f"{at}: saturation", second[1], 0.0, _LARGEST_SATURATION, "")
        except ValueError as error:
            self.notes.append(f"{error}; it is left out")
            return [(0.0, 0.0), (1.0, 0.0)]
        return [first, second]

    def _controls(self, at: str, records: dict[str, list[float]]) -> dict[str, Any]:
        controls: dict[str, Any] = {}
        for model, numbers in records.items():
            known, what = _READ_AS.get(model), f"{at}: {model}"
            if known in _MACHINES:
                continue
            family = next((family for family, names in _FAMILIES.items() if re.match(names, model)), "")
            if known is not None and not (known == "IEEEST" and numbers[0] != 1.0):
                if (control := self._control(what, known, self._values(at, model, numbers))) is not None:
                    controls[family] = control
                continue
            self._unknown[model] += 1
            if family in ("exciter", "governor"):
                controls[family] = TYPICAL_EXCITER if family == "exciter" else TYPICAL_GOVERNOR
                self.notes.append(f"{what} is not here: a typical {family} stands in its place")
            else:
                self.notes.append(f"{what} is not here: it is left out")
        return controls

    def _control(self, at: str, model: str, values: dict[str, float]) -> Any:
        """Return the parameters of a control; None where it does not act."""
        if "_gain" in values:
            if values["_gain"] == 0.0:
                self.notes.append(f"{at}: its gain is 0, so that it does not act; it is left out")
                return None
            values["droop_pu"] = 1.0 / values["_gain"]
        if values.get("_bus_2"):
            self.notes.append(f"{at}: its second shaft is left out")
        if "saturation_1" in values:
            points = [(values[f"saturation_voltage_{k}_pu"], values[f"saturation_{k}"]) for k in (1, 2)]
            for k, (voltage, saturation) in enumerate(self._saturation(at, *points), start=1):
                values[f"saturation_voltage_{k}_pu"], values[f"saturation_{k}"] = voltage, saturation
            if values["regulator_max_pu"] == 0.0:
                values["regulator_max_pu"] = _NO_LIMIT
                self.notes.append(f"{at}: VRMAX = 0 means no limit, {_NO_LIMIT:g} p.u.")
        if model == "STAB1":
            values["gain"] = values["_gain_over_time"] * values["washout_time_s"]
            for k in (1, 2):
                values[f"lead_time_{k}_s"] = values[f"_ratio_{k}"] * values[f"lag_time_{k}_s"]
        if model == "IEEEST":
            for name in ("voltage_min_pu", "voltage_max_pu"):
                values[name] = values[name] if 0.0 < values[name] < _NO_LIMIT else 0.0
        return made(at, MODELS[model], **{name: value for name, value in values.items() if not name.startswith("_")})
