"""Evidence that the simulator is right: other simulators' traces, the paper's claims, the error of its steps."""
