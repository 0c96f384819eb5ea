"""The simulator: aerodynamics, tracking law, machines, network, and their integration."""
