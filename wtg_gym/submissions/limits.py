"""How large a submission may be. Every limit is far above what a policy of this benchmark needs."""

from __future__ import annotations

#: Bytes of policy.onnx, entry.toml and README.md.
MODEL_BYTES = 5_000_000
ENTRY_BYTES = 16_384
README_BYTES = 65_536
#: Versions of the operator set and of the file format.
OPSETS = range(13, 22)
IR_VERSIONS = range(6, 11)
#: Numbers in all constants together.
PARAMETERS = 1_000_000
NODES = 2_000
#: Axes of a tensor, and length of one.
AXES = 6
AXIS_LENGTH = 1_000_000
#: Numbers that one lane needs in a step, all intermediate values together.
VALUES_PER_LANE = 262_144
#: Multiplications of matrices that one lane needs in a step.
PRODUCTS_PER_LANE = 5_000_000
STATES = 16

#: Lanes of the batch that is timed, as many as the evaluator plays at a time, and how long a step of it may take [s].
TIMED_LANES = 256
STEP_S = 0.25
#: Largest difference of a lane's actions, [-1, 1], between batches that differ in the other lanes.
LANE_TOLERANCE = 1e-3
#: Two policies whose actions, [-1, 1], differ by no more than this (root mean square over the rollout) are copies. The
#: shipped training seeds that are most alike differ by more than seven times as much.
COPY_TOLERANCE = 5e-3

#: Of the process that plays a policy: address space [bytes], processor time [s].
MEMORY_BYTES = 2 * 2**30
CPU_S = 900
#: How long a policy is waited for: until it is loaded, for one step, and in all [s].
LOAD_S = 60.0
CALL_S = 10.0
TOTAL_S = 3600.0
