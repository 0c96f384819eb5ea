"""Where studies write their tables and pictures."""

from pathlib import Path

DOCS = Path(__file__).resolve().parents[1]
