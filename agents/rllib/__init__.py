"""PPO of Ray RLlib, on one machine or on a Ray cluster."""
