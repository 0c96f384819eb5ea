"""Names: what people read of one, and what it stands for before any policy is looked for."""

from __future__ import annotations

import functools
import unicodedata
from pathlib import Path

from wtg_gym.physics.tracking_law import STRATEGY_NAMES

#: The package with the baselines, and the name of all trained policies together.
BASELINES, POLICIES = "baselines", "policies"
#: Words that are nobody's name: those two, and the packages of a checkout.
RESERVED = (BASELINES, POLICIES, "agents", "tests", "wtg_gym")
#: Greek letters and the Latin ones that they look like.
_LOOKS = str.maketrans("βγκτω", "byktw")
#: Small letters and digits that are one line or one ring in many typefaces.
_SAME = str.maketrans("1i0", "llo")
_PACKAGE = Path(__file__).resolve().parents[1]
INSTALLED = (_PACKAGE / "shipped").is_dir()
#: The folder with `baselines` and `agents/policies`: a checkout's root, or the copies in an installed package.
ROOT = _PACKAGE / "shipped" if INSTALLED else _PACKAGE.parent


def plain_name(name: str) -> str:
    """Return what people read of a name: no capitals, blanks and signs, and letters as what they look like."""
    plain = unicodedata.normalize("NFKC", name).translate(_LOOKS).casefold().translate(_SAME)
    return "".join(sign for sign in plain if sign.isalnum())


def is_built_in(name: str) -> bool:
    """Return whether a name is, or looks like, that of a strategy or a baseline."""
    return plain_name(name) in _built_in()


def check_not_built_in(what: str, name: str) -> None:
    """Raise a ValueError if a name is, or looks like, that of a strategy or a baseline, or a reserved word.

    Args:
        what: what has the name, for the message.
        name: the name; of one with dots, such as a module's, the first part may not be a reserved word either.
    """
    first = plain_name(name.partition(".")[0])
    if is_built_in(name) or first in {plain_name(word) for word in RESERVED}:
        raise ValueError(
            f"{what} must not be, or look like, that of a strategy or a baseline or one of {', '.join(RESERVED)}; "
            f"got {ascii(name)[:80]}"
        )


@functools.cache
def _built_in() -> frozenset[str]:
    # A baseline is called like its module.
    modules = (path.stem for path in (ROOT / BASELINES).glob("*.py"))
    return frozenset(plain_name(name) for name in (*STRATEGY_NAMES, *modules))
