"""The source papers beside nsdyn: writes demos/guide/papers.md and its figures, demos/papers/*.png.

    python demos/papers/page.py [SECTION]... [--problems FOLDER]... [--limit S]

A section is coulomb (the solvers, on the FCLIB files of the folders, by default those of the tests), increments,
accelerations or dual; the sections that are not named stay as they are. All of them are written if none is named.
"""

import argparse
import importlib
import re
import sys
from pathlib import Path

HERE = Path(__file__).parent
SECTIONS = "coulomb", "increments", "accelerations", "dual"

HEAD = """# The source papers

Figures and numbers of the papers that nsdyn rests on, reproduced or refuted. `python demos/papers/page.py --problems
FOLDER` writes this page and draws its figures; `python demos/papers/page.py increments` writes the section of that name
anew, and so for `coulomb`, `accelerations` and `dual`.

`increments` and `dual` need scikit-fem (extra `fem`), `accelerations` clarabel (extra `acceleration`). The contact
problems of `coulomb` are FCLIB files (HDF5): 19 of FCLIB's collection and of the test data of Siconos
(`numerics/src/FrictionContact/test/data` in its sources), 8 rigid-body problems in FCLIB's global form on which most
solvers fail, and 6 steps of a wall that a ball hits. They are not part of this repository; without `--problems` the
section is made from the small ones in `tests/data`, which `tests/data/make.py` writes.
"""


def main() -> None:
    """Write the sections that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sections", nargs="*", choices=[[], *SECTIONS], default=[], metavar="SECTION")
    parser.add_argument("--problems", action="append", default=[], metavar="FOLDER")
    parser.add_argument("--limit", type=float, default=0.5, help="s of processor time a solve (coulomb)")
    arguments = parser.parse_args()
    sys.path.append(str(HERE.parent))  # demos/elastic_block.py
    path = HERE.parent / "guide" / "papers.md"
    new = {}
    for name in arguments.sections or SECTIONS:
        module = importlib.import_module(name)  # beside this script
        options = {"folders": arguments.problems, "limit": arguments.limit, "progress": True}
        try:
            new[name] = module.report(pictures=HERE, **options) if name == "coulomb" else module.report(HERE)
        except ModuleNotFoundError as missing:
            if missing.name != "skfem":
                raise
            parser.exit(2, f"{name} needs scikit-fem: pip install 'nsdyn[fem]'\n")
    old, parts = path.read_text() if path.exists() else "", [HEAD]
    for name in SECTIONS:
        begin, end = f"<!-- {name} -->", f"<!-- end of {name} -->"
        kept = re.search(f"{begin}\n(.*?)\n{end}", old, re.S)
        text = new.get(name, kept.group(1) if kept else "")
        if text:
            parts.append(f"{begin}\n{text.strip()}\n{end}\n")
    path.write_text("\n".join(parts))
    print(path)


if __name__ == "__main__":
    main()
