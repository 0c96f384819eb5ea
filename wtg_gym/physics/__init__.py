"""The simulator: aerodynamics, tracking law, machines, network, and their integration.

The list
    step                what happens in a step and at the start of a run, in its order

Kinds of unit and their systems
    units, starting     the lane, buses, units of the network; what a run starts from
    machine_unit, hydro_unit, wtg_unit, extension_unit, source_unit    machines, WTG groups, imposed sources
    protection          what ends a run, trips a group or sheds a load; centres of inertia of islands
    local_frequency     at every bus, and the worst
    further_units       kinds of one's own
    runge_kutta         a stage of the integration, made of rates

Equations
    aerodynamics, rotor_table    C_p as a curve or a table, operating points K_opt, K_d, available power
    wind_turbine        rotor, captured power p_w, a group as a whole, the search for its equilibrium
    pitch, converter, extended_converter    controls of a wind turbine
    machine, exciter, governor              synchronous machines
    sensors             measurements with filter, noise, bias and delay

Models of machines that only some plants have (machine_models says which)
    stab1, ieeest, ieeex1, ieeeg1, ieesgo, gast    stabilisers, exciters, governors with their turbines
    saturation                                     of exciters and of GENROU
    machine_controls, control_blocks               what controls have in common: as units, and as equations

Network
    network             admittances, power flow
    reduction           Kron reduction, what events and islands change in it
    network_events      the table of what events change in the network and its units

Data
    parameters, machine_parameters, control_parameters, checked    every number with unit, source and range
    ieee14, tables/     the network; the C_p of another turbine
    plant, network_data a network, its WTG groups and the time steps; constants, series and events as arrays
    scenario            what happens in a run
    tracking_law        the strategies
    trajectory          a recorded run

Machinery
    simulator, block_threads, integration    runs side by side; their threads; one control interval
    layout              rows of a block
    equilibrium, start_errors    the lists of the start around the power flow; why a run cannot start
    linearisation       the state matrix, and the step that its modes allow

A run is *prepared*, its equilibrium found while no running lane is touched, and then *started* in a lane. All higher
layers use these two verbs.
"""
