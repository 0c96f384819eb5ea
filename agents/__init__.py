"""Training of policies for the benchmark with Stable-Baselines3, and their export to ONNX; see README.md."""
