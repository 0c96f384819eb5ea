"""`wtg-gym report` as a user calls it."""

import html
import re

import pytest

from wtg_gym import evaluate, get_suite
from wtg_gym.cli import main

pytest.importorskip("matplotlib")

HEADINGS = [
    *("Score", "Where control decides", "Bad runs", "Scenarios"),
    *("Operators' tests", "Faults of sensors", "Energy", "Damping"),
]
NAME = "a & b"
LAW = f'name = "{NAME}"\nk_min = 0.75\nk_nominal = 0.7\nk_max = 0.6\ntau_s = 0.8\n'


def test_a_page_has_every_section_loads_nothing_and_escapes_names(tmp_path):
    law = tmp_path / "law.toml"
    law.write_text(LAW, encoding="utf-8")
    page = tmp_path / "page.html"
    assert main(["report", str(law), "--episodes", "3", "--seed", "20000", "--output", str(page)]) == 0
    text = page.read_text(encoding="utf-8")
    assert [html.unescape(heading) for heading in re.findall("<h2[^>]*>(.*?)</h2>", text)] == HEADINGS
    assert re.findall('(?:src|href)="(.{11})', text) == ["data:image/"] * 2
    assert "a &amp; b" in text and NAME not in text
    assert f"--seeds 20000 --entries {law}" in text


def test_a_page_of_markdown_has_the_numbers_of_the_evaluation_and_the_dearest_scenario_first(tmp_path):
    page, seeds = tmp_path / "page.md", get_suite("standard-v1").test[:3]
    assert main(["report", "fast-droop", "--episodes", "3", "--output", str(page)]) == 0
    text = page.read_text(encoding="utf-8")
    results = evaluate(["fast-droop"], "standard-v1", "test", seeds=seeds)
    assert f"| all, strata count alike | 3 | {results.scores['fast-droop'].value:.1f} |" in text
    costs = {episode.seed: episode.metrics["cost"] for episode in results.episodes_of("fast-droop")}
    shown = [int(seed) for seed in re.findall(r"\(page-seed-(\d+)\.svg\)", text)]
    assert shown == sorted(seeds, key=costs.get, reverse=True)
