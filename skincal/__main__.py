"""``python -m skincal`` is ``skincal``."""

import sys
from pathlib import Path

if not sys.flags.safe_path and sys.path and sys.path[0] == str(Path.cwd()):
    # -m puts the working folder first, where a dataset may come with files named as modules.
    del sys.path[0]

from skincal.cli.main import main

if __name__ == "__main__":
    main()
