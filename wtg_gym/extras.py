"""Messages about missing optional dependencies."""


def install_advice(extra: str) -> str:
    """Return how to install an extra of the package. No index has the package, so it takes a checkout."""
    return f"in a checkout: pip install '.[{extra}]'"
