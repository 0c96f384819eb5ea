"""The measurements behind docs/agents.md and docs/benchmark.md, each a command of its own."""
