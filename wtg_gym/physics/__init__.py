"""The simulator: aerodynamics, tracking law, machines, network, and their integration.

The list
    step                what happens in a step and at the start of a run, in its order

Kinds of unit and their systems
    units, starting     the lane, buses, units of the network, a stage of the integration; what a run starts from
    machine_unit, wtg_unit    machines, WTG groups
    machine_models      stabilisers, exciters and governors that only some machines have
    machine_controls    what these have in common
    devices             kinds of one's own, and imposed sources
    protection          what ends a run, trips a group or sheds a load; centres of inertia, local frequencies

Equations
    aerodynamics, rotor_table    C_p as a curve or a table, operating points K_opt, K_d, available power
    wind_turbine        rotor, captured power p_w, pitch, a group as a whole, the search for its equilibrium
    converter           tracking law, swing equation, limits and voltage control
    machine             synchronous machines with SEXS and TGOV1
    sensors             measurements with filter, noise, bias and delay

Network
    network             admittances, power flow
    reduction           Kron reduction, what events and islands change in it

Data
    parameters, machine_parameters    every number with unit, source and range
    grid, tables/       networks, and their files; the C_p of another turbine
    plant               a network, its WTG groups and the time steps
    scenario            what happens in a run
    tracking_law        the strategies
    trajectory          a recorded run

Machinery
    simulator, integration    runs side by side, on threads; one control interval
    layout              rows of a block; constants, series and events as arrays
    equilibrium         what events change; the lists of the start around the power flow; why a run cannot start
    linearisation       the state matrix, and the step that its modes allow

A run is *prepared*, its equilibrium found while no running lane is touched, and then *started* in a lane. All higher
layers use these two verbs.
"""
