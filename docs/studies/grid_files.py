"""`python docs/studies/grid_files.py FOLDER …`: which grid files are read exactly, and why others are refused."""

import sys
from collections import Counter, defaultdict
from pathlib import Path

from wtg_gym.grids.reading import read_case

FORMATS = {
    ".m": "MATPOWER .m",
    ".mat": "MATPOWER .mat",
    ".raw": "PSS/E RAW",
    ".rawx": "PSS/E RAWX",
    ".zip": "CGMES",
    ".uct": "UCTE",
    ".txt": "IEEE-CDF",
    ".cdf": "IEEE-CDF",
    ".dgs": "PowerFactory",
    ".json": "pandapower",
    ".xiidm": "XIIDM",
    ".jiidm": "XIIDM",
}
#: Words of a refusal, and what the table calls it.
REASONS = {
    "finds no power flow": "not solved by its library",
    "no generator in service": "no machine",
    "no machine is at the slack": "no machine at the slack bus",
    "has what no grid here has": "other elements or islands",
    "statements": "statements of MATLAB",
    "no matrix of numbers": "statements of MATLAB",
    "at most 2000": "above 2,000 buses",
    "flat start": "no solution from a flat start",
    "cannot read it": "not read by its library",
}


def main() -> None:
    exact, refused = Counter[str](), defaultdict[str, Counter[str]](Counter)
    for path in sorted(path for folder in sys.argv[1:] for path in Path(folder).rglob("*")):
        name = FORMATS.get(path.suffix.lower())
        if name is None or not path.is_file():
            continue
        try:
            read_case(path)
            exact[name] += 1
        except ValueError as error:
            reason = next((text for words, text in REASONS.items() if words in str(error)), "other")
            refused[name][reason] += 1
            print(f"{path}: {error}", file=sys.stderr)
    print("| format | read exactly | refused |\n| --- | --- | --- |")
    for name in dict.fromkeys(FORMATS.values()):
        reasons = ", ".join(f"{n} {reason}" for reason, n in refused[name].most_common())
        print(f"| {name} | {exact[name]} | {reasons or '–'} |")


if __name__ == "__main__":
    main()
