"""The simulator: aerodynamics, tracking law, machines, network, and their integration.

Equations
    aerodynamics, rotor_table    C_p as a curve or a table, operating points K_opt, K_d, available power
    wind_turbine        rotor, captured power p_w, a group as a whole, its equilibrium
    pitch, converter, extended_converter    controls of a wind turbine
    machine, exciter, governor              synchronous machines
    network             admittances, power flow
    reduction           Kron reduction, what events change in it, load noise
    dynamics            right-hand side: loops over units and lanes
    currents, runge_kutta        I = Y E and its limit; how a stage moves the states
    network_events      the table of what events change in the network and its units
    protection          what ends a run, trips a group or sheds a load
    sensors             measurements with filter, noise, bias and delay
    equilibrium, start_errors    what a run starts from; why it cannot
    linearisation       the state matrix, and the step that its modes allow

Data
    parameters, machine_parameters, checked    every number with unit, source and range
    ieee14, tables/     the network; the C_p of another turbine
    plant               a network, its WTG groups and the time steps
    scenario            what happens in a run
    tracking_law        the strategies
    trajectory          a recorded run

Machinery
    simulator, block_threads, integration    runs side by side; their threads; one control interval
    layout, records, kernel_data    rows of a block, made from records; constants, series and events
    compiled, elementary            compilation and its cache, functions for all processors

A run is *prepared*, its equilibrium found while no running lane is touched, and then *started* in a lane: every floor
above, up to the environments, says it with these two words.
"""
