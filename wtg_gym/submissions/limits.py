"""How large and slow a submission may be. Every limit is far above what a policy of this benchmark needs."""

from __future__ import annotations

#: Bytes of policy.onnx, entry.toml and README.md.
MODEL_BYTES = 5_000_000
ENTRY_BYTES = 16_384
README_BYTES = 65_536
#: How long a policy may take for one scenario's step [s].
ANSWER_S = 1e-3
#: Two policies whose actions, [-1, 1], differ by no more than this (root mean square over the rollout) are copies. The
#: shipped training seeds that are most alike differ by more than seven times as much.
COPY_TOLERANCE = 5e-3
