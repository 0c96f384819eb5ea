"""The examples of the README and of every page of docs/ run as printed; links of every page lead somewhere.

The README's first program and all commands run on what `pip install .` installs, in an empty folder, without the
extras' packages. The other programs run with everything that the tests need.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
#: Packages that extras bring and `pip install .` does not.
EXTRAS = (
    "bokeh",
    "joblib",
    "matplotlib",
    "onnx",
    "pettingzoo",
    "PIL",
    "pygame",
    "rich",
    "stable_baselines3",
    "torch",
)


def blocks(page: str, language: str) -> list[str]:
    text = (ROOT / page).read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL)


#: Every page of docs/.
DOCS = sorted(str(page.relative_to(ROOT)) for page in (ROOT / "docs").rglob("*.md"))


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the package as `pip install .` installs it, and nothing of the checkout."""
    target = tmp_path_factory.mktemp("installed")
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    # Modules that no command imports need no bytecode.
    options = ["--no-deps", "--no-build-isolation", "--no-compile", "--target", str(target)]
    subprocess.run([*pip, "install", *options, str(ROOT)], check=True, capture_output=True)
    return target


@pytest.fixture(scope="module")
def plain(wheel: Path) -> dict[str, str]:
    """Environment variables under which Python finds the installed package, and none of the extras' packages."""
    names = ", ".join(repr(name) for name in EXTRAS)
    (wheel / "sitecustomize.py").write_text(f"import sys\nsys.modules.update(dict.fromkeys(({names})))\n")
    path = f"{wheel / 'bin'}{os.pathsep}{os.environ['PATH']}"
    return {**os.environ, "PYTHONPATH": str(wheel), "PATH": path, "PYTHONIOENCODING": "utf-8"}


def run(command: list[str], folder: Path, environment: dict[str, str] | None = None) -> str:
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, encoding="utf-8")
    assert done.returncode == 0, f"{command[-1]}\n{done.stderr}"
    return done.stdout


def test_readme_is_short_and_has_programs_and_commands() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 150
    assert [len(blocks("README.md", "python")), len(blocks("README.md", "sh"))] == [2, 1]
    assert sum(len(blocks(page, "python")) for page in DOCS) >= 7
    assert sum(len(blocks(page, "sh")) for page in DOCS) >= 2


def test_wheel_is_what_runs_and_holds_no_package_of_another_name(plain: dict[str, str], tmp_path: Path) -> None:
    wheel = Path(plain["PYTHONPATH"])
    said = run([sys.executable, "-c", "import wtg_gym; print(wtg_gym.__file__)"], tmp_path, plain)
    assert Path(said.strip()) == wheel / "wtg_gym" / "__init__.py"
    assert not (wheel / "baselines").exists() and not (wheel / "agents").exists()


def test_first_program_runs_after_a_plain_install_in_an_empty_folder_and_prints(
    plain: dict[str, str], tmp_path: Path
) -> None:
    said = run([sys.executable, "-c", blocks("README.md", "python")[0]], tmp_path, plain)
    assert re.fullmatch(r"cost \d+\.\d, \d\d\.\d\d … \d\d\.\d\d Hz, no failure\n", said)
    assert said in blocks("docs/start.md", "text")


def test_commands_run_after_a_plain_install_in_an_empty_folder(plain: dict[str, str], tmp_path: Path) -> None:
    for page in ("README.md", *DOCS):
        for block in blocks(page, "sh"):
            said = run(["bash", "-euc", block], tmp_path, plain)
            assert "coordinated-piecewise" in said, said


RUN_HERE = ["README.md", *(page for page in DOCS if blocks(page, "python"))]


@pytest.mark.parametrize("page", RUN_HERE)
def test_every_other_program_runs_as_printed(page: str, tmp_path: Path) -> None:
    for program in blocks(page, "python")[1 if page == "README.md" else 0 :]:
        run([sys.executable, "-c", program], tmp_path)


PAGES = [
    ROOT / "README.md",
    ROOT / "CHANGELOG.md",
    ROOT / "CONTRIBUTING.md",
    *(ROOT / page for page in DOCS),
    ROOT / "agents/README.md",
    ROOT / "tests/golden/README.md",
]


def anchors(page: Path) -> set[str]:
    """Return the names under which GitHub finds a page's headings."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    headings = re.findall(r"^#+ (.*)$", text, flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_leads_to_a_file_and_a_heading(page: Path) -> None:
    # Code, such as a hostile text that a table quotes, is shown and leads nowhere.
    text = re.sub(r"`[^`]*`", "", page.read_text(encoding="utf-8"))
    for file, anchor in re.findall(r"\]\(([^)#:]*)(?:#([^)]*))?\)", text):
        target = page.parent / file if file else page
        assert target.exists(), file
        assert not anchor or anchor in anchors(target), f"{file}#{anchor}"
