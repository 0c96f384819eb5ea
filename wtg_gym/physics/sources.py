"""Sources of the parameters."""

from __future__ import annotations

#: What the short keys in each field's `source` stand for.
SOURCES = {
    "paper": "Chen, Xi, Cheng, Dörfler, Lestas: Coordinated Primary Frequency Regulation and Grid-Forming Control "
    "for Wind Turbine Generators (2026): table of parameters, equation of C_p, case studies",
    "inferred": "the only round set found that meets λ_opt, C_popt, λ_n and λ_pr of the paper's table to every "
    "printed digit; the paper prints no c_1 … c_6",
    "Heier": "S. Heier: Grid Integration of Wind Energy, the exponential C_p form and its pitch term",
    "Milano": "F. Milano: IEEE 14-bus dynamic data as distributed with PSAT (d_014_dyn_l14)",
    "IEEE 14": "IEEE 14-bus power-flow test case, University of Washington archive; the same numbers as MATPOWER's "
    "case14. Voltages of machine buses are its scheduled ones",
    "NREL 5 MW": "J. Jonkman et al.: Definition of a 5-MW Reference Wind Turbine, NREL/TP-500-38060 (2009)",
    "calibrated": "chosen so that the paper's settled frequency (0.996 p.u.) and the final power of WTG 2 below 0.3 "
    "p.u. both come out",
    "ENTSO-E": "Commission Regulation (EU) 2016/631 (requirements for generators), article 13, continental Europe; "
    "voltages: article 16",
    "REGFM_A1": "W. Du et al.: Model Specification of Droop-Controlled, Grid-Forming Inverters (REGFM_A1), Pacific "
    "Northwest National Laboratory, PNNL-32278 (2021), approved by WECC",
    "ENTSO-E defence": "Commission Regulation (EU) 2017/2196 (emergency and restoration), annex: automatic low "
    "frequency demand disconnection, continental Europe",
    "FERC 827": "Federal Energy Regulatory Commission, Order 827 (2016): reactive power requirements for "
    "non-synchronous generation",
    "HYGOV": "typical data of the hydro governor HYGOV of PSS/E; P. Kundur: Power System Stability and Control, 9.1",
    "design": "a design value of this benchmark",
}
