# /// script
# requires-python = ">=3.11"
# dependencies = ["torchrl==0.14.1", "torch==2.13.0"]
# ///
import torch
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.envs import GymEnv, ParallelEnv
from torchrl.envs.libs.gym import default_info_dict_reader

import wtg_gym


def make() -> GymEnv:
    env = GymEnv("GFMWTG-14bus-v1", strategy="coordinated-tuned")
    return env.set_info_dict_reader(default_info_dict_reader(["cost", "frequency_hz"]))


if __name__ == "__main__":
    actor = nn.Sequential(nn.Linear(make().observation_spec["observation"].shape[-1], 64), nn.Tanh(), nn.Linear(64, 8))
    policy = TensorDictModule(actor, in_keys=["observation"], out_keys=["action"])
    with torch.no_grad():
        one, many = make().rollout(20, policy), ParallelEnv(2, make).rollout(20, policy)
    print(one["next", "frequency_hz"].min(), many["next", "reward"].sum(1).mean())
    wtg_gym.export_onnx(actor, "torchrl", name="my TorchRL agent", strategy="coordinated-tuned")
