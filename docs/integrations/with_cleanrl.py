# /// script
# requires-python = ">=3.11"
# dependencies = ["torch==2.13.0"]
# ///
"""PPO in one file, in the manner of CleanRL."""

import sys
import time

import gymnasium as gym
import torch
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import NormalizeReward
from torch import nn
from torch.distributions import Normal

from wtg_gym import export_onnx

seconds, seed = map(int, sys.argv[1:]) if sys.argv[1:] else (5, 0)
torch.set_num_threads(1)
torch.manual_seed(seed)
N_ENVS, N_STEPS, GAMMA, LAMBDA = 64, 64, 0.998, 0.95
task = {"strategy": "coordinated-tuned", "autoreset_mode": AutoresetMode.SAME_STEP}
native = gym.make_vec("wtg_gym:GFMWTG-14bus-v1", num_envs=N_ENVS, n_threads=1, **task)
envs = NormalizeReward(native, gamma=GAMMA)
n_observation, n_action = envs.single_observation_space.shape[0], envs.single_action_space.shape[0]


def network(n_out: int, gain: float) -> nn.Sequential:
    layers = [nn.Linear(n_observation, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, n_out)]
    nn.init.orthogonal_(layers[-1].weight, gain)
    nn.init.zeros_(layers[-1].bias)
    return nn.Sequential(*layers)


# Zero action is a good controller to begin with, and noise costs.
actor, critic, log_std = network(n_action, 0.01), network(1, 1.0), nn.Parameter(torch.full((n_action,), -4.0))
parameters = [*actor.parameters(), *critic.parameters(), log_std]
optimizer = torch.optim.Adam(parameters, lr=2e-4, eps=1e-5)
observations = torch.zeros(N_STEPS, N_ENVS, n_observation)
actions = torch.zeros(N_STEPS, N_ENVS, n_action)
log_probs, rewards, values, over = (torch.zeros(N_STEPS, N_ENVS) for _ in range(4))

end = time.process_time() + seconds
n_steps, latest = 0, torch.as_tensor(envs.reset(seed=seed)[0])
while time.process_time() < end:
    with torch.no_grad():
        for step in range(N_STEPS):
            noisy = Normal(actor(latest), log_std.exp())
            observations[step], actions[step], values[step] = latest, noisy.sample(), critic(latest)[:, 0]
            log_probs[step] = noisy.log_prob(actions[step]).sum(1)
            following, reward, terminated, truncated, infos = envs.step(actions[step].numpy())
            latest = torch.as_tensor(following)
            rewards[step] = torch.as_tensor(reward)
            over[step] = torch.as_tensor(terminated | truncated)
            for index in truncated.nonzero()[0]:  # time is over for the episode, not for the grid
                rewards[step, index] += GAMMA * critic(torch.as_tensor(infos["final_obs"][index]))[0]
        advantages, following, after = torch.zeros(N_STEPS, N_ENVS), critic(latest)[:, 0], 0.0
        for step in reversed(range(N_STEPS)):
            goes_on = 1 - over[step]
            error = rewards[step] + GAMMA * goes_on * following - values[step]
            advantages[step] = after = error + GAMMA * LAMBDA * goes_on * after
            following = values[step]
        returns = advantages + values
    n_steps += N_STEPS * N_ENVS
    rows = [array.flatten(0, 1) for array in (observations, actions, log_probs, advantages, returns)]
    for _ in range(5):
        for chosen in torch.randperm(N_STEPS * N_ENVS).chunk(4):
            seen, done, old, gain, target = (array[chosen] for array in rows)
            ratio = (Normal(actor(seen), log_std.exp()).log_prob(done).sum(1) - old).exp()
            gain = (gain - gain.mean()) / (gain.std() + 1e-8)
            policy_loss = -torch.min(gain * ratio, gain * ratio.clamp(0.8, 1.2)).mean()
            loss = policy_loss + 0.5 * (critic(seen)[:, 0] - target).square().mean()
            optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(parameters, 0.5)
            optimizer.step()
print(n_steps, "steps")
export_onnx(actor, "cleanrl", name="my agent of CleanRL", strategy="coordinated-tuned", training_seed=seed)
