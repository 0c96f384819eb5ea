"""Policies: entries and where they are found, ONNX files in a locked process, submissions and their gate."""

from wtg_gym.policies.entry import Entry, Policy
from wtg_gym.policies.entry_folder import load_entries
from wtg_gym.policies.policy_process import OnnxPolicy, PolicyError

__all__ = ["Entry", "OnnxPolicy", "Policy", "PolicyError", "load_entries"]
