"""The programs and commands of the README and of docs/ run as printed; notebooks were run; links lead somewhere.

The README's first program and all commands run on what `pip install .` installs, in an empty folder, without the
extras' packages. The other programs, those of a page in one process, run with everything that the tests need. Of 90
scenarios three are played, of 300,000 steps of training 20,000, of 6 updates 2. `make notebooks` runs the notebooks.
What is installed is pinned.
"""

import importlib.metadata
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from integrations import PROGRAMS, packages_of
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import wtg_gym
from wtg_gym.cli import build_app

ROOT = Path(__file__).resolve().parent.parent
#: Packages that extras bring and `pip install .` does not.
EXTRAS = ("bokeh", "joblib", "matplotlib", "onnx", "pettingzoo", "PIL", "pygame", "rich", "stable_baselines3", "torch")
NOTEBOOKS = sorted((ROOT / "docs/notebooks").glob("*.ipynb"))
#: What is printed, and what runs in its place.
SHORTER = {"--scenarios 90": "--scenarios 3", "10_090": "10_003", "=300_000": "=20_000", "in range(6):": "in range(2):"}
DOCS = sorted(str(page.relative_to(ROOT)) for page in (ROOT / "docs").rglob("*.md"))
PAGES = ["README.md", "CHANGELOG.md", "CONTRIBUTING.md", *DOCS, "agents/README.md", "tests/golden/README.md"]


def blocks(page: str, language: str) -> list[str]:
    text = (ROOT / page).read_text(encoding="utf-8")
    for printed, played in SHORTER.items():
        text = text.replace(printed, played)
    return re.findall(rf"^```{language}\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL)


def test_what_is_played_shorter_is_printed():
    pages = "".join((ROOT / page).read_text(encoding="utf-8") for page in PAGES)
    assert all(printed in pages for printed in SHORTER)


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """Environment variables under which Python finds the package as `pip install .` installs it, and no extra's."""
    target = tmp_path_factory.mktemp("installed")
    # Modules that no command imports need no bytecode.
    options = ["--quiet", "--no-deps", "--no-build-isolation", "--no-compile", "--target", str(target)]
    subprocess.run([sys.executable, "-m", "pip", "install", *options, str(ROOT)], check=True, capture_output=True)
    (target / "sitecustomize.py").write_text(f"import sys\nsys.modules.update(dict.fromkeys({EXTRAS}))\n")
    path = f"{target / 'bin'}{os.pathsep}{os.environ['PATH']}"
    return {**os.environ, "PYTHONPATH": str(target), "PATH": path, "PYTHONIOENCODING": "utf-8"}


def run(command: list[str], folder: Path, environment: dict[str, str] | None = None) -> str:
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, encoding="utf-8")
    assert done.returncode == 0, f"{command[-1]}\n{done.stderr}"
    return done.stdout


def test_first_program_runs_after_a_plain_install_in_an_empty_folder_and_prints(plain, tmp_path):
    installed = Path(plain["PYTHONPATH"])
    message = run([sys.executable, "-c", "import wtg_gym; print(wtg_gym.__file__)"], tmp_path, plain)
    assert Path(message.strip()) == installed / "wtg_gym" / "__init__.py"
    assert not (installed / "baselines").exists() and not (installed / "agents").exists()
    empty_cache = {**plain, "XDG_CACHE_HOME": str(tmp_path)}
    message = run([sys.executable, "-c", blocks("README.md", "python")[0]], tmp_path, empty_cache)
    assert message in blocks("docs/start.md", "text") and not list(tmp_path.rglob("*.nbc")), "it compiled"


def test_commands_run_after_a_plain_install_in_an_empty_folder(plain, tmp_path):
    commands, done = [block for page in ("README.md", *DOCS) for block in blocks(page, "sh")], set[str]()
    assert len(commands) > 1
    for block in commands:
        # Two pages may have commands in common.
        new = [line for line in block.splitlines() if line not in done]
        assert not new or run(["bash", "-euc", "\n".join(new)], tmp_path, plain)
        done.update(new)


@pytest.mark.parametrize("page", ["README.md", *(page for page in DOCS if blocks(page, "python"))])
def test_every_other_program_runs(page, tmp_path):
    for saved in (ROOT / page).parent.glob("*.py"):
        shutil.copy(saved, tmp_path)
    programs_of_page = blocks(page, "python")[1 if page == "README.md" else 0 :]
    each = "import json, sys\nfor one in json.loads(sys.argv.pop()):\n    exec(one, {'__name__': '__main__'})"
    run([sys.executable, "-c", each, json.dumps(programs_of_page)], tmp_path)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_was_run_from_top_to_bottom_without_an_error_and_its_commands_are_known(path, tmp_path, monkeypatch):
    """Running the notebooks takes minutes: a command that has lost an option is found here."""
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert code and [cell["execution_count"] for cell in code] == list(range(1, len(code) + 1))
    outputs = [output for cell in code for output in cell["outputs"]]
    assert outputs and not [output for output in outputs if output["output_type"] == "error"]
    (tmp_path / "my-policy").mkdir()
    monkeypatch.chdir(tmp_path)
    for line in "\n".join("".join(cell["source"]) for cell in cells).splitlines():
        if line.startswith("!wtg-gym "):
            words = shlex.split(line.partition(" 2>")[0])[1:]
            build_app(words).parse_args(words, exit_on_error=False, print_error=False)


def test_every_program_of_another_library_is_on_its_page_and_names_its_packages():
    page = (ROOT / "docs/integrations.md").read_text(encoding="utf-8")
    assert all(f"(integrations/{program.name})" in page and packages_of(program) for program in PROGRAMS)


def anchors(page: Path) -> set[str]:
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    headings = re.findall(r"^#+ (.*)$", text, flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_a_release_has_addresses_and_an_install_command_of_its_own(tmp_path):
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, encoding="utf-8", check=True).stdout
    texts = [name for name in listed.splitlines() if name.endswith((".md", ".py", ".toml", ".cff"))]
    for name in texts:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes((ROOT / name).read_bytes())
    urls = {name: f"https://example.org/{name}" for name in ("repository", "site", "paper")}
    options = [word for name, url in urls.items() for word in (f"--{name}", url)]
    run([sys.executable, str(ROOT / ".ci/addresses"), *options, "--folder", str(tmp_path)], tmp_path)
    for name in texts:
        if name != "tests/test_readme.py":
            text = (tmp_path / name).read_text(encoding="utf-8")
            assert not re.search("(REPOSITORY|SITE|PAPER)_URL", text), name
    project = tomllib.loads((tmp_path / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert set(project["urls"].values()) == set(urls.values())
    assert all(url in (tmp_path / "CITATION.cff").read_text(encoding="utf-8") for url in urls.values())
    page = (tmp_path / "README.md").read_text(encoding="utf-8")
    assert "pip install wtg-gym" in page and "git clone" not in page and "pip install '." not in page
    code, released = "from wtg_gym.extras import *; print(install_advice('x'))", {"PYTHONPATH": str(tmp_path)}
    advice = run([sys.executable, "-P", "-c", code], tmp_path, {**os.environ, **released})
    assert advice == "pip install 'wtg-gym[x]'\n"


@pytest.mark.parametrize("name", PAGES)
def test_every_link_leads_to_a_file_and_a_heading(name):
    page = ROOT / name
    # Code, such as a hostile text that a table quotes, is shown and leads nowhere.
    text = re.sub(r"`[^`]*`", "", page.read_text(encoding="utf-8"))
    for file, anchor in re.findall(r"\]\(([^)#:]*)(?:#([^)]*))?\)", text):
        if file.endswith("_URL"):
            # Its address comes with a release.
            continue
        target = page.parent / file if file else page
        assert target.exists(), file
        assert not anchor or anchor in anchors(target), f"{file}#{anchor}"


WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))


def pins(name: str) -> dict[str, list[str]]:
    text = (ROOT / name).read_text(encoding="utf-8").replace("\\\n", "")
    lines = (line.split("--hash=") for line in text.splitlines() if not line.startswith("#"))
    return {requirement.strip(): [one.strip() for one in hashes] for requirement, *hashes in lines}


def installed(requirement: Requirement, seen: set[str]) -> set[str]:
    """Return the names of all that a requirement brings into this environment, extras in brackets."""
    for extra in ("", *sorted(requirement.extras)):
        key = f"{canonicalize_name(requirement.name)}[{extra}]"
        if key not in seen:
            seen.add(key)
            for needed in map(Requirement, importlib.metadata.requires(requirement.name) or ()):
                if needed.marker is None or needed.marker.evaluate({"extra": extra}):
                    installed(needed, seen)
    return seen


def test_public_names_are_those_of_their_modules_and_no_others_and_typed():
    assert all(getattr(wtg_gym, name) is not None and name in dir(wtg_gym) for name in wtg_gym.__all__)
    assert (Path(wtg_gym.__file__).parent / "py.typed").exists()
    assert wtg_gym.GFMWTGEnv is wtg_gym.envs.GFMWTGEnv and wtg_gym.evaluate is wtg_gym.evaluation.evaluate
    with pytest.raises(AttributeError, match="no attribute 'evaluat'"):
        wtg_gym.evaluat  # noqa: B018


@pytest.mark.skipif(shutil.which("git") is None or not (ROOT / ".git").exists(), reason="needs a checkout and git")
def test_nothing_that_is_made_anew_is_in_the_repository():
    """Results, environments and machine code that somebody had added would be used instead of one's own."""
    command = ["git", "ls-files", "--cached", "--ignored", "--exclude-standard"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout == ""


@pytest.mark.parametrize("name", ["constraints.txt", ".ci/uv.txt"])
def test_every_pin_is_one_version_with_its_hashes(name):
    for requirement, hashes in pins(name).items():
        assert re.fullmatch(r"[a-z0-9-]+==[a-z0-9.]+( ; .+)?", requirement)
        assert hashes and all(re.fullmatch("sha256:[0-9a-f]{64}", one) for one in hashes), requirement


def test_tools_of_the_release_and_all_that_tests_install_are_pinned():
    pinned = {requirement.split("==")[0] for requirement in (*pins("constraints.txt"), *pins(".ci/uv.txt"))}
    assert {"build", "editables", "hatchling", "twine", "uv"} <= pinned
    brought = {key.partition("[")[0] for key in installed(Requirement("wtg-gym[dev]"), set())}
    assert {"numpy", "pytest", "torch"} <= brought and brought - pinned == {"wtg-gym"}


def test_checkout_installs_by_its_pins_only():
    for path in (ROOT / "Makefile", *WORKFLOWS, *(ROOT / ".ci").iterdir()):
        assert not re.search(r"-m pip |/pip |^ *(- run: )?pip ", path.read_text(encoding="utf-8"), re.MULTILINE), path


def test_workflows_name_actions_by_their_commit():
    uses = [line for path in WORKFLOWS for line in path.read_text(encoding="utf-8").splitlines() if "uses:" in line]
    assert uses
    for line in uses:
        assert re.fullmatch(r" *(- )?uses: [\w.-]+/[\w.-]+@[0-9a-f]{40} # v\d+\.\d+\.\d+", line), line
