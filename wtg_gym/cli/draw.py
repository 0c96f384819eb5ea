"""The options that say which scenarios of a suite: split and seeds, and what fresh ones are drawn from."""

from __future__ import annotations

import argparse
from pathlib import Path

from wtg_gym.scenarios import N_DRAWN, SPLITS, VERIFICATION, VerificationDraw, draw_seeds

_LARGEST_SECRET = 4096


def add_split_options(parser: argparse.ArgumentParser) -> None:
    """Add `--split` and `--seeds`, and what the split "verification" needs."""
    parser.add_argument(
        "--split",
        choices=(*SPLITS, VERIFICATION),
        default="test",
        help="which seeds of the suite; verification: fresh ones, drawn from a commit and a secret (default: test)",
    )
    parser.add_argument(
        "--seeds", nargs="+", metavar="A:B", help="seeds of the split, N or A:B with B left out (default: all)"
    )
    group = parser.add_argument_group("fresh scenarios", f"for --split {VERIFICATION}")
    group.add_argument("--commit", metavar="HASH", help="full hash of the git commit with the entries")
    group.add_argument("--secret-file", metavar="FILE", help="file with the secret, 16 bytes or more")
    group.add_argument("--scenarios", type=int, metavar="N", help=f"how many to draw (default: {N_DRAWN})")


def chosen_draw(arguments: argparse.Namespace) -> VerificationDraw | None:
    """Return the draw that the options name, None for another split; a ValueError says what is missing or wrong."""
    given = {
        option: value
        for option, value in (
            ("--commit", arguments.commit),
            ("--secret-file", arguments.secret_file),
            ("--scenarios", arguments.scenarios),
        )
        if value is not None
    }
    if arguments.split != VERIFICATION:
        if given:
            raise ValueError(f"{', '.join(given)}: for --split {VERIFICATION} only, the split is {arguments.split}")
        return None
    missing = [option for option in ("--commit", "--secret-file") if option not in given]
    if missing or arguments.seeds is not None:
        raise ValueError(
            f"--split {VERIFICATION} draws its seeds from --commit and --secret-file, without --seeds; "
            f"missing: {', '.join(missing) or 'none'}"
        )
    n = N_DRAWN if arguments.scenarios is None else arguments.scenarios
    return draw_seeds(arguments.suite, arguments.commit, read_secret(arguments.secret_file), n)


def read_secret(path: str) -> bytes:
    """Return a secret, without blanks around it; a ValueError if it cannot be read or is too large."""
    try:
        with Path(path).open("rb") as file:
            content = file.read(_LARGEST_SECRET + 1)
    except OSError as error:
        raise ValueError(f"--secret-file {path}: {error.strerror}") from error
    if len(content) > _LARGEST_SECRET:
        raise ValueError(f"--secret-file {path}: larger than {_LARGEST_SECRET} bytes")
    return content.strip()


__all__ = ["add_split_options", "chosen_draw", "read_secret"]
