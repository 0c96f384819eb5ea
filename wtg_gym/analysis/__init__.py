"""Evidence: steady states, small signal, the paper's claims, other simulators' traces, step error, benchmarks."""
