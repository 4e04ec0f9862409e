"""Makes the bundled dataset ``data/paper-like`` again, bit for bit: ``python -m data.make_sample --out FOLDER``.

Run it from the project's root, as it uses the sessions of ``benchmarks/sessions.py``. It prints what the session was
made with and the hash of what was written; both stand in ``data/README.md``.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from benchmarks.sessions import make_session
from skincal.dataset import dataset_hash, write_dataset
from skincal.errors import SkincalError

SEED = 2024
POSITION_SIGMA_M = 0.6e-3
RESOLUTION_M = 0.25e-3
SOURCE = (
    "Synthetic, no measurement: made by data/make_sample.py with skincal's own skin model and the protocol of "
    "Kasolowsky & Baeuml, IROS 2024. Licence: MIT, as skincal."
)


def main() -> None:
    """Writes the dataset and prints what it was made with."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--out", type=Path, default=Path(__file__).parent / "paper-like", help="folder to write"
    )
    parser.add_argument("--force", action="store_true", help="replace a dataset that is there")
    arguments = parser.parse_args()
    session, truth = make_session(
        np.random.default_rng(SEED),
        position_sigma_m=POSITION_SIGMA_M,
        resolution_m=RESOLUTION_M,
        source=SOURCE,
    )
    try:
        write_dataset(session, arguments.out, force=arguments.force)
    except SkincalError as error:
        parser.exit(error.exit_status, f"{error}\n")
    told = truth.as_positions_tell
    told_pose = {"y_m": told.y_m, "beta_deg": told.beta_deg}
    written = {"truth": truth.plain(), "truth_as_the_positions_tell_it": told_pose}
    print(json.dumps(written | {"sha256": dataset_hash(arguments.out)}, indent=2))


if __name__ == "__main__":
    main()
