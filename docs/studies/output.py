"""The one option of a study, the folder that it writes into: `python docs/studies/NAME.py --output FOLDER`."""

import argparse
from pathlib import Path


def folder(doc, default="docs"):
    """Return the folder of `--output`; the study's docstring is its help."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path(default), metavar="FOLDER", help="(default: %(default)s)")
    return parser.parse_args().output
