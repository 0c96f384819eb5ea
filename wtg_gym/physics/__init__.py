"""The simulator: aerodynamics, tracking law, machines, network, and their integration.

`step` lists what happens in a step and at the start of a run, in its order. Kinds of unit and their systems: `units`,
`starting`, `machine_unit`, `wtg_unit`, `machine_models`, `control_blocks`, `devices`, `protection`. Equations:
`aerodynamics`, `rotor_table`, `wind_turbine`, `converter`, `machine`, `sensors`. Network: `network`, with its
events in `network_events`. Data: `parameters`, `machine_parameters`, `grid`, `plant`, `scenario`, `tracking_law`,
`trajectory`. Machinery: `simulator`, `integration`, `layout`, `equilibrium`, `linearisation`.

A run is *prepared*, its equilibrium found while no running environment is touched, then *started* in one. All higher
layers use these two verbs.
"""
