"""The one option of a study: the folder with the pages and pictures that it renews."""

import argparse
from pathlib import Path


def folder(doc):
    """Return the folder of `--output`; the study's docstring is its help."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("docs"), metavar="FOLDER", help="(default: docs)")
    return parser.parse_args().output
