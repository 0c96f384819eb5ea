"""Evidence: other simulators' traces, step error, studies of the model, benchmarks."""
