"""The simulator: aerodynamics, tracking law, machines, network, and their integration.

Equations
    aerodynamics, rotor_table    C_p as a curve or a table, operating points K_opt, K_d, available power
    wind_turbine        rotor, captured power p_w, a group as a whole, its equilibrium
    pitch, converter, converter_limits, voltage_control    controls of a wind turbine
    machine, exciter, governor, hydro_governor             synchronous machines
    network             admittances, power flow
    reduction           Kron reduction, load noise
    dynamics            I = Y E, right-hand side, Runge-Kutta method
    network_events      what events change in the network and its units
    protection          what ends a run
    equilibrium, start_errors    what a run starts from; why it cannot
    linearisation       modes, and the step they allow

Data
    parameters, ieee14, nrel5mw    every number with unit, source and range; the network; another turbine
    plant               a network, its WTG groups and the time steps
    scenario            what happens in a run
    tracking_law        the strategies
    trajectory          a recorded run

Machinery
    simulator, integration    runs side by side; one control interval
    layout, records           rows of a block, made from records
    compiled, machine_code, elementary    compilation, its cache, functions for all processors
"""
