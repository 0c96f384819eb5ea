"""Where the golden cases lie, and which there are."""

from __future__ import annotations

from pathlib import Path

GOLDEN = Path(__file__).resolve().parent / "golden"
#: Every trace with its parameter file.
CASES = [
    (folder / "params.json", trace) for folder in sorted(GOLDEN.iterdir()) for trace in sorted(folder.glob("*.csv"))
]
